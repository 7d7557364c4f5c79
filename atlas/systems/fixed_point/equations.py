"""Euler-Poisson equations of a gyrostat about a fixed point in a central Newtonian field.

They are the system (1) of Amer, Abo Essa, Ibrahim & Amer in dimensional form, for any inertia I, centre of mass r_c and gyrostatic
momentum l. `tests/systems/test_fixed_point_equations.py` derives them from the Lagrangian. All vectors are given in the body's
principal axes at the fixed point. The angular velocity is w = (p, q, r), and g (gamma) is the unit vector of the vertical Z, which
points down to the attracting centre. Mg is the weight, and N is the gradient of the field.

    I w' = (I w + l) x w + Mg r_c x g + N g x (I g) - damping w,     g' = g x w

The paper has no damping. With damping the energy falls at the rate damping |w|^2.

Every function takes the state and the constants as sequences in the order of STATE and CONSTANTS. It is plain
arithmetic, which works for numbers and for arrays of one shape. The source is copied into the kernels. The functions
may therefore use no imports and only names of this file.
"""

STATE = ("p", "q", "r", "g1", "g2", "g3")
# The unit vector at rest in space.
FRAME_VECTORS = (("g1", "g2", "g3"),)
# Mx, My, Mz stand for Mg x0, Mg y0, Mg z0. NA, NB, NC stand for N A, N B, N C.
CONSTANTS = (
    "A", "B", "C", "A_inv", "B_inv", "C_inv", "l1", "l2", "l3", "Mx", "My", "Mz", "NA", "NB", "NC", "damping",
)  # fmt: skip
# Constants that are 1 in the kernels' units.
ONES = ()
# A key names a first integral, which is a function below. The value is the exponent of 1 / time in the unit of the integral.
INTEGRALS = {"energy": 2, "area": 1, "length_gamma": 0, "lagrange": 1, "clebsch": 2, "kovalevskaya": 4}
# A key names a first integral that damping changes. The value names the function below that returns the integral's loss per time.
LOSSES = {"energy": "energy_loss"}


def rhs(state, constants):
    """Return the time derivatives of the state. The terms with Mg and N are the torque g x F."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    L1, L2, L3 = A * p + l1, B * q + l2, C * r + l3
    F1, F2, F3 = NA * g1 - Mx, NB * g2 - My, NC * g3 - Mz
    return (
        (L2 * r - L3 * q + g2 * F3 - g3 * F2 - damping * p) * A_inv,
        (L3 * p - L1 * r + g3 * F1 - g1 * F3 - damping * q) * B_inv,
        (L1 * q - L2 * p + g1 * F2 - g2 * F1 - damping * r) * C_inv,
        g2 * r - g3 * q,
        g3 * p - g1 * r,
        g1 * q - g2 * p,
    )


def scaled(state, constants, h):
    """Return state and constants in units in which the time `h` is 1."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    return (p * h, q * h, r * h, g1, g2, g3), (
        A, B, C, A_inv, B_inv, C_inv, l1 * h, l2 * h, l3 * h,
        Mx * h * h, My * h * h, Mz * h * h, NA * h * h, NB * h * h, NC * h * h, damping * h,
    )  # fmt: skip


def unscaled(state, constants, h):
    """Return a state of `scaled` in the original units."""
    p, q, r, g1, g2, g3 = state
    return p / h, q / h, r / h, g1, g2, g3


def frame_motion(state, constants):
    """Return the angular velocity w relative to space, then the vertical g. These two vectors are linear in the state."""
    p, q, r, g1, g2, g3 = state
    return p, q, r, g1, g2, g3


# A first integral returns a tuple of terms, because the change of the sum is compared with the magnitudes of the terms.


def energy(state, constants):
    """Kinetic energy plus the potential -Mg r_c . g + (N/2) g . I g. The rotor does not contribute."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    return (
        0.5 * (A * p * p + B * q * q + C * r * r),
        -(Mx * g1 + My * g2 + Mz * g3),
        0.5 * (NA * g1 * g1 + NB * g2 * g2 + NC * g3 * g3),
    )


def area(state, constants):
    """Angular momentum about the vertical, (I w + l) . g."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    return (A * p + l1) * g1, (B * q + l2) * g2, (C * r + l3) * g3


def length_gamma(state, constants):
    """Squared length of the unit vector gamma, which is 1."""
    p, q, r, g1, g2, g3 = state
    return g1 * g1, g2 * g2, g3 * g3


def lagrange(state, constants):
    """C r + l3, which is conserved if A = B, l1 = l2 = 0 and Mg x0 = Mg y0 = 0."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    return C * r, l3


def clebsch(state, constants):
    """|I w + l|^2 - N det(I) g . I^-1 g, which is conserved if Mg r_c = 0 and either l = 0 or the field exerts no torque."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    L1, L2, L3 = A * p + l1, B * q + l2, C * r + l3
    return (L1 * L1 + L2 * L2 + L3 * L3, -(NB * C * g1 * g1 + NC * A * g2 * g2 + NA * B * g3 * g3))


def kovalevskaya(state, constants):
    """Kovalevskaya's integral with a rotor, which is conserved if A = B = 2 C, Mg z0 = 0, l1 = l2 = 0 and N = 0."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    x, y, rotor = Mx * C_inv, My * C_inv, l3 * C_inv
    real = p * p - q * q + x * g1 - y * g2
    imaginary = 2 * p * q + x * g2 + y * g1
    transverse = p * p + q * q
    return (
        real * real,
        imaginary * imaginary,
        2 * rotor * r * transverse,
        -2 * rotor * rotor * transverse,
        4 * rotor * g3 * (x * p + y * q),
    )


def energy_loss(state, constants):
    """Return the loss of `energy` per time, which is damping times |w|^2."""
    p, q, r, g1, g2, g3 = state
    A, B, C, A_inv, B_inv, C_inv, l1, l2, l3, Mx, My, Mz, NA, NB, NC, damping = constants
    return damping * (p * p + q * q + r * r)
