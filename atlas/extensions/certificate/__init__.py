"""Labels that are proved for every duration, by the energy or by two momenta."""

from ...extension import Extension

EXTENSION = Extension(
    "certificate",
    __name__,
    "labels that hold for every duration, proved by the energy or by the momenta of a top",
    needs=("equilibria",),
    instruments=dict.fromkeys(("label_proof", "label_inertial_proof", "proof_bound"), "proofs:PROOFS"),
)
