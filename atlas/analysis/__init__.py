"""Questions to an atlas; numbers and tables, no figures."""
