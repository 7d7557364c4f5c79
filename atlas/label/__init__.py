"""Labels of motions: measured by integration, predicted by theory."""
