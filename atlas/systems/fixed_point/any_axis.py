"""Regular precessions and permanent rotations of the gyrostat about other axes than the third and the vertical.

A motion w = n nu + m s has an axis s at rest in the body and an axis nu at rest in space; theta1 is the angle between
them and kappa that from nu to the vertical g. Its equations are linear in the body, that is in I, l and w = Mg r_c.
Written as harmonics of the angles n t and m t they allow, with n, m, sin theta1 not 0:

- kappa not 0 and N not 0: the harmonic 2 n + 2 m and then 2 n + m (n - m in place of n + m if their signs differ)
  leave a spherical body, of which the field has no effect, and so no weight (next item). `free_precession`;
- kappa not 0, N = 0 and w not 0: the harmonics n + m and n - m of the weight need |n| = |m| and theta1 = pi/2; what
  remains is `grioli`. Without weight the body is symmetric about s: `free_precession`;
- kappa = 0 and N = n^2: the field and the centrifugal torque cancel, and s is normal to a circular section of the
  ellipsoid of inertia: `balanced_field`;
- kappa = 0 otherwise: the body is symmetric about s, which carries rotor and centre of mass: `conical`, or
  `other_axis` where s is not the third axis.

A permanent rotation that is inclined to the vertical needs a free body, `free_rotation`, or it is a rotation about a
resting axis of symmetry, `rest` or `other_axis`. So together with the families about the third axis these are all.
`tests/systems/test_any_axis_families.py` confirms each step.

References
----------
G. Grioli, Ann. Mat. Pura Appl. 26 (1947) 271-281; with a rotor E. I. Kharlamova, Mekh. Tverd. Tela 2 (1970) 35-37.
"""

from __future__ import annotations

from ..base import numbered
from . import families
from .balanced_field import BALANCED_FIELD
from .free import FREE_PRECESSION, FREE_ROTATION
from .grioli import GRIOLI
from .other_axis import OTHER_AXIS

FAMILIES = numbered(
    (GRIOLI, BALANCED_FIELD, FREE_ROTATION, FREE_PRECESSION, OTHER_AXIS), after=families.FAMILIES
)
