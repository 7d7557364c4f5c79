"""Ends of motions. Damped gyrostats end in the wells of their potential; ends of other motions are groups with equal statistics."""

from ...extension import Extension

EXTENSION = Extension(
    "basins",
    __name__,
    "the equilibria in which damped motions end, how that is known, and times of settling",
    needs=("equilibria",),
    questions={"basin_fractions": "fractions:basin_fractions", "ends": "groups:ends"},
    instruments=dict.fromkeys(
        ("end_equilibrium", "end_theta0", "end_psi0", "end_phi0", "end_index", "settled_by"), "ends:ENDS"
    )
    | {"settling_time": "ends:SETTLING"},
    flag_texts={"end_equilibrium": "attitude:texts"},
)
