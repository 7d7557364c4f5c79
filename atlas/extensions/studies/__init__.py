"""Studies of error against run time, of stiff and extreme cases, and of labels under other settings."""

from ...extension import Extension

EXTENSION = Extension(
    "studies",
    __name__,
    "error against run time, stiff and extreme cases with known labels, labels under other settings",
    commands={"accuracy": "commands:measure_accuracy", "stress": "commands:run_stress_cases"},
    needs=("equilibria", "plane"),
    stress_cases={"satellite": "plane_cases:satellite_cases", "fixed_point": "cases:fixed_point_cases"},
)
