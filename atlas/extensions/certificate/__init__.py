"""Labels that are proved for every duration, by the energy or by two momenta."""

from ...extension import Extension
from ...flags import Flag

BOUND = "proof_bound"
PROOFS_OF = {"label": "label_proof", "label_inertial": "label_inertial_proof"}


class Proof(Flag):
    """How a label is proved."""

    NONE = 0, "no proof"
    ENERGY = 1, "for every duration the motion has the predicted label: the energy keeps it near a minimum"
    MOMENTA = (
        2,
        "for every duration the motion has the predicted label: two momenta limit the nutation of a top",
    )


EXTENSION = Extension(
    "certificate",
    __name__,
    "labels that hold for every duration, proved by the energy or by the momenta of a top",
    needs=("equilibria",),
    instruments=dict.fromkeys((*PROOFS_OF.values(), BOUND), "proofs:PROOFS"),
)
