"""Euler-Poisson equations of the magnetised satellite-gyrostat on a circular orbit, with a torque of drag.

They follow from the kinematics (1), the Lagrangian (2) and the potential (3) of Yehia & El-kenani 2021 (doi 10.22055/JACM.2021.37913.3113).
`tests/systems/test_satellite_equations.py` repeats the derivation. All vectors are given in the body's principal axes. The absolute angular
velocity is w, the inertia I, the rotor's momentum k and the magnetic moment mu (with the paper's sign). The unit vector along the radius is
a (alpha), the unit normal of the orbit is g (gamma), and beta = gamma x alpha. Omega is the orbit's rate, and H is the magnetic field.

    I w' = (I w + k) x w + 3 Omega^2 a x (I a) + H x mu + beta x drag - damping u,     H = h1 a + h3 g
    a' = a x u,   g' = g x u,                                                           u = w - Omega g

Drag has the potential drag.beta. The paper has no drag and no damping. With damping the Jacobi integral falls at the rate damping |u|^2.

Every function takes the state and the constants as sequences in the order of STATE and CONSTANTS. It is plain
arithmetic, which works for numbers and for arrays of one shape. The source is copied into the kernels. The functions
may therefore use no imports and only names of this file. A name with a star stands for unused constants.

The equations hold in any unit of time, for an a of any length 1 / a_inv and a g of any length 1 / g_inv. The
kernels use units in which most factors are 1 (`scaled`). Everywhere else a and g are unit vectors.
"""

STATE = ("w1", "w2", "w3", "a1", "a2", "a3", "g1", "g2", "g3")
# Unit vectors at rest in the orbital frame.
FRAME_VECTORS = (("a1", "a2", "a3"), ("g1", "g2", "g3"))
# Parameters of body and fields come first. The vectors a (radius) and g (normal) may have any length. Therefore h1 is divided by
# |a|, Omega and h3 by |g|, and drag by |a| |g|. Factors in the right-hand side follow: D1 = (B - C)/A and so on, a_inv = 1 / |a|,
# g_inv = 1 / |g|, N = 3 Omega^2 / |a|^2 (here Omega is undivided), and rotor, magnet, drag and damping divided by moments of inertia.
CONSTANTS = (
    "A", "B", "C", "Omega", "k1", "k2", "k3", "mu1", "mu2", "mu3", "h1", "h3",
    "D1", "D2", "D3", "N", "a_inv", "g_inv", "k2_A", "k3_A", "k3_B", "k1_B", "k1_C", "k2_C",
    "mu3_A", "mu2_A", "mu1_B", "mu3_B", "mu2_C", "mu1_C",
    "drag3_A", "drag2_A", "drag1_B", "drag3_B", "drag2_C", "drag1_C", "drag1", "drag2", "drag3",
    "damping_A", "damping_B", "damping_C",
)  # fmt: skip
# Constants that enter the hash of a point only if they are not 0.
OPTIONAL = tuple(name for name in CONSTANTS if name.startswith("drag"))
# Constants that are 1 in the kernels' units.
ONES = ("N", "Omega")
# A key names a first integral, which is a function below. The value is the exponent of 1 / time in the unit of the integral.
INTEGRALS = {"jacobi": 2, "length_alpha": 0, "length_gamma": 0, "length_sum": 0, "axial_momentum": 1}
# A key names a first integral that damping changes. The value names the function below that returns the integral's loss per time.
LOSSES = {"jacobi": "jacobi_loss", "axial_momentum": "axial_momentum_loss"}


def rhs(state, constants):
    """Return the time derivatives of the state."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    (
        A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv,
        k2_A, k3_A, k3_B, k1_B, k1_C, k2_C, mu3_A, mu2_A, mu1_B, mu3_B, mu2_C, mu1_C,
        drag3_A, drag2_A, drag1_B, drag3_B, drag2_C, drag1_C, drag1, drag2, drag3, damping_A, damping_B, damping_C,
    ) = constants  # fmt: skip
    H1, H2, H3 = h1 * a1 + h3 * g1, h1 * a2 + h3 * g2, h1 * a3 + h3 * g3
    b1, b2, b3 = g2 * a3 - g3 * a2, g3 * a1 - g1 * a3, g1 * a2 - g2 * a1
    u1, u2, u3 = w1 - Omega * g1, w2 - Omega * g2, w3 - Omega * g3
    return (
        (D1 * w2 + k2_A) * w3 - k3_A * w2 - N * D1 * a2 * a3 + H2 * mu3_A - H3 * mu2_A
        + b2 * drag3_A - b3 * drag2_A - damping_A * u1,
        (D2 * w3 + k3_B) * w1 - k1_B * w3 - N * D2 * a3 * a1 + H3 * mu1_B - H1 * mu3_B
        + b3 * drag1_B - b1 * drag3_B - damping_B * u2,
        (D3 * w1 + k1_C) * w2 - k2_C * w1 - N * D3 * a1 * a2 + H1 * mu2_C - H2 * mu1_C
        + b1 * drag2_C - b2 * drag1_C - damping_C * u3,
        a2 * u3 - a3 * u2,
        a3 * u1 - a1 * u3,
        a1 * u2 - a2 * u1,
        g2 * u3 - g3 * u2,
        g3 * u1 - g1 * u3,
        g1 * u2 - g2 * u1,
    )  # fmt: skip


def scaled(state, constants, h):
    """Return state and constants in units in which the time `h` is 1.

    N and Omega become 1, because a has the length sqrt(3) Omega h and g has the length Omega h. Without an orbit
    both vectors are so short that they have no effect.
    """
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    (
        A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv,
        k2_A, k3_A, k3_B, k1_B, k1_C, k2_C, mu3_A, mu2_A, mu1_B, mu3_B, mu2_C, mu1_C,
        drag3_A, drag2_A, drag1_B, drag3_B, drag2_C, drag1_C, drag1, drag2, drag3, damping_A, damping_B, damping_C,
    ) = constants  # fmt: skip
    a = (N * h * h + 1e-200) ** 0.5
    g = Omega * h + 1e-100
    square = h * h / (a * g)
    return (w1 * h, w2 * h, w3 * h, a * a1, a * a2, a * a3, g * g1, g * g2, g * g3), (
        A, B, C, Omega * h / g, k1 * h, k2 * h, k3 * h, mu1 * h * h, mu2 * h * h, mu3 * h * h, h1 / a, h3 / g,
        D1, D2, D3, N * h * h / (a * a), a_inv / a, g_inv / g,
        k2_A * h, k3_A * h, k3_B * h, k1_B * h, k1_C * h, k2_C * h,
        mu3_A * h * h, mu2_A * h * h, mu1_B * h * h, mu3_B * h * h, mu2_C * h * h, mu1_C * h * h,
        drag3_A * square, drag2_A * square, drag1_B * square, drag3_B * square, drag2_C * square, drag1_C * square,
        drag1 * square, drag2 * square, drag3 * square,
        damping_A * h, damping_B * h, damping_C * h,
    )  # fmt: skip


def unscaled(state, constants, h):
    """Return a state of `scaled` in the original units. The constants are the scaled constants."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    return w1 / h, w2 / h, w3 / h, a1 * a_inv, a2 * a_inv, a3 * a_inv, g1 * g_inv, g2 * g_inv, g3 * g_inv


def frame_motion(state, constants):
    """Return the angular velocity w - Omega g relative to the orbital frame, then the normal g. These vectors are linear in the state."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    return w1 - Omega * g1, w2 - Omega * g2, w3 - Omega * g3, g1 * g_inv, g2 * g_inv, g3 * g_inv


def axis_in_frame(state, constants):
    """Return the components of the third body axis along the radius and along the velocity."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    return a3 * a_inv, (g1 * a2 - g2 * a1) * a_inv * g_inv


# A first integral returns a tuple of terms, because the change of the sum is compared with the magnitudes of the terms.


def jacobi(state, constants):
    """Jacobi integral L2 - L0 + V. L2 and L0 are the kinetic energy's terms of degree 2 and 0 in u = w - Omega g. V includes drag."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    (
        A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, *_,
        drag1, drag2, drag3, damping_A, damping_B, damping_C,
    ) = constants  # fmt: skip
    return (
        0.5 * (A * w1 * w1 + B * w2 * w2 + C * w3 * w3),
        -Omega * (g1 * (A * w1 + k1) + g2 * (B * w2 + k2) + g3 * (C * w3 + k3)),
        0.5 * N * (A * a1 * a1 + B * a2 * a2 + C * a3 * a3),
        h1 * (mu1 * a1 + mu2 * a2 + mu3 * a3) + h3 * (mu1 * g1 + mu2 * g2 + mu3 * g3)
        + drag1 * (g2 * a3 - g3 * a2) + drag2 * (g3 * a1 - g1 * a3) + drag3 * (g1 * a2 - g2 * a1),
    )  # fmt: skip


def length_alpha(state, constants):
    """Squared length of the unit vector alpha, which is 1."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    a1, a2, a3 = a1 * a_inv, a2 * a_inv, a3 * a_inv
    return a1 * a1, a2 * a2, a3 * a3


def length_gamma(state, constants):
    """Squared length of the unit vector gamma, which is 1."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    g1, g2, g3 = g1 * g_inv, g2 * g_inv, g3 * g_inv
    return g1 * g1, g2 * g2, g3 * g3


def length_sum(state, constants):
    """Squared length of alpha + gamma, which is 2 as alpha . gamma = 0. The terms cannot all vanish, unlike those of alpha . gamma."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, mu1, mu2, mu3, h1, h3, D1, D2, D3, N, a_inv, g_inv, *_ = constants
    x, y, z = a1 * a_inv + g1 * g_inv, a2 * a_inv + g2 * g_inv, a3 * a_inv + g3 * g_inv
    return x * x, y * y, z * z


def axial_momentum(state, constants):
    """Axial momentum C w3 + k3. Only damping changes this sum if A = B and neither rotor, magnet nor drag has a transverse part."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, k1, k2, k3, *_ = constants
    return C * w3, k3


# Losses are computed from damping_A alone. First integrals then fall at these rates only if damping_B and damping_C are also right.


def jacobi_loss(state, constants):
    """Return the loss of `jacobi` per time, which is damping times |u|^2 for u = w - Omega g."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, *_, damping_A, damping_B, damping_C = constants
    u1, u2, u3 = w1 - Omega * g1, w2 - Omega * g2, w3 - Omega * g3
    return A * damping_A * (u1 * u1 + u2 * u2 + u3 * u3)


def axial_momentum_loss(state, constants):
    """Return the loss of `axial_momentum` per time, which is damping times u3 = w3 - Omega g3."""
    w1, w2, w3, a1, a2, a3, g1, g2, g3 = state
    A, B, C, Omega, *_, damping_A, damping_B, damping_C = constants
    return A * damping_A * (w3 - Omega * g3)
