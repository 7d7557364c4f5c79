"""From a plan to labels: the pipeline, the prediction of theory, trajectories."""
