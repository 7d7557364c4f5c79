"""Amer, Abo Essa, Ibrahim & Amer 2013: the gyrostat about a fixed point in a central Newtonian field."""

from ...extension import Extension

# Longest run for which errors of the paper's solution are computed. The length of a run is its duration times the fastest frequency,
# in rad. The integration of a chunk of points with runs of this length takes some seconds.
MAX_RADIANS = 1000.0

EXTENSION = Extension(
    "amer2013",
    __name__,
    "equations of Amer et al. as printed and as true; errors of their solution",
    needs=("catalogue",),
    variables=dict.fromkeys(
        (
            "first_order_error",
            "first_order_rate_error",
            "first_order_error_printed",
            "first_order_rate_error_printed",
        ),
        "variables:solution_errors",
    )
    | dict.fromkeys(
        ("periodic_stability", "periodic_period", "periodic_trace"), "variables:periodic_solutions"
    ),
    published={"fixed_point": "published:PUBLISHED"},
)
