"""Attitude of a satellite on an elliptic orbit, over the true anomaly.

Written by atlas.systems.from_lagrangian from the Lagrangian

    L = nu_rate**2/2
        + (e*cos(nu) + 1)**2*(A*(roll_rate*cos(yaw) - (pitch_rate + 1)*sin(yaw)*cos(roll))**2 + B*(yaw_rate + (pitch_rate + 1)*sin(roll))**2 + C*(roll_rate*sin(yaw) + (pitch_rate + 1)*cos(roll)*cos(yaw))**2)/2
        - (3*e*cos(nu) + 3)*(A*(-sin(pitch)*sin(roll)*sin(yaw) + cos(pitch)*cos(yaw))**2 + B*sin(pitch)**2*cos(roll)**2 + C*(sin(pitch)*sin(roll)*cos(yaw) + sin(yaw)*cos(pitch))**2)/2

and the generalised forces

    Q_nu = e*(e*cos(nu) + 1)*(A*(roll_rate*cos(yaw) - (pitch_rate + 1)*sin(yaw)*cos(roll))**2 + B*(yaw_rate + (pitch_rate + 1)*sin(roll))**2 + C*(roll_rate*sin(yaw) + (pitch_rate + 1)*cos(roll)*cos(yaw))**2)*sin(nu)
           - 3*e*(A*(-sin(pitch)*sin(roll)*sin(yaw) + cos(pitch)*cos(yaw))**2 + B*sin(pitch)**2*cos(roll)**2 + C*(sin(pitch)*sin(roll)*cos(yaw) + sin(yaw)*cos(pitch))**2)*sin(nu)/2
"""

from numpy import cos, sin

STATE = ("pitch", "roll", "yaw", "nu", "pitch_rate", "roll_rate", "yaw_rate", "nu_rate")
CONSTANTS = ("A", "B", "C", "e")
INTEGRALS = ()


def rhs(state, constants):
    """Time derivatives of the state; f is the right-hand side of M v' = f, with the mass matrix M = K D K^T."""
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    cos_nu = cos(nu)
    sin_roll = sin(roll)
    cos_roll = cos(roll)
    cos_yaw = cos(yaw)
    sin_yaw = sin(yaw)
    cos_pitch = cos(pitch)
    sin_pitch = sin(pitch)
    sin_nu = sin(nu)
    sum1 = cos_nu * e + 1.0
    common1 = B * cos_roll * cos_roll
    common13 = C * cos_yaw * cos_yaw
    common14 = A * cos_roll * cos_roll
    D1 = (
        sum1 * sum1 * (B - common1 + common13 * cos_roll * cos_roll - common14 * cos_yaw * cos_yaw + common14)
    )
    K21 = cos_roll * cos_yaw * sin_yaw * sum1 * sum1 * (C - A) / D1
    K31 = B * sin_roll * sum1 * sum1 / D1
    common6 = cos_roll * (pitch_rate + 1.0)
    common9 = cos_yaw * roll_rate - common6 * sin_yaw
    common10 = A * common9 * sin_yaw
    common7 = common6 * cos_yaw + roll_rate * sin_yaw
    common11 = A * common9 * cos_yaw + C * common7 * sin_yaw
    common12 = A * sin_yaw * sin_yaw
    common2 = cos_pitch * cos_yaw - sin_pitch * sin_roll * sin_yaw
    common3 = cos_pitch * sin_yaw + cos_yaw * sin_pitch * sin_roll
    common4 = sin_roll * (pitch_rate + 1.0)
    common5 = B * (common4 + yaw_rate)
    common8 = C * common7 * cos_yaw
    f_pitch_rate = sum1 * (
        3 * A * common2 * (cos_pitch * sin_roll * sin_yaw + cos_yaw * sin_pitch)
        - 3 * C * common3 * (cos_pitch * cos_yaw * sin_roll - sin_pitch * sin_yaw)
        - 3 * common1 * cos_pitch * sin_pitch
        - cos_roll * sum1 * yaw_rate * (A * common7 * sin_yaw + C * common9 * cos_yaw - common11)
        + 2 * e * nu_rate * sin_nu * (common5 * sin_roll - common10 * cos_roll + common8 * cos_roll)
        - roll_rate
        * sum1
        * (
            A * common9 * sin_roll * sin_yaw
            + B * cos_roll * sin_roll * (pitch_rate + 1.0)
            + B * cos_roll * (common4 + yaw_rate)
            - common12 * common4 * cos_roll
            - common13 * common4 * cos_roll
            - common8 * sin_roll
        )
    )
    D2 = sum1 * sum1 * (A + C * sin_yaw * sin_yaw - common12) - D1 * K21 * K21
    K32 = -D1 * K21 * K31 / D2
    D3 = B * sum1 * sum1 - D1 * K31 * K31 - D2 * K32 * K32
    f_yaw_rate = sum1 * (
        2 * B * e * nu_rate * sin_nu * (common4 + yaw_rate)
        - B * common6 * roll_rate * sum1
        - 3 * common2 * common3 * (C - A)
        + common7 * common9 * sum1 * (C - A)
    )
    f_roll_rate = sum1 * (
        2 * common11 * e * nu_rate * sin_nu
        - common4 * cos_yaw * roll_rate * sin_yaw * sum1 * (A - C)
        - 3
        * cos_roll
        * sin_pitch
        * (C * common3 * cos_yaw - A * common2 * sin_yaw - B * sin_pitch * sin_roll)
        - sum1 * yaw_rate * (C * common7 * cos_yaw - A * common7 * cos_yaw + C * common9 * sin_yaw - common10)
        + sum1 * (pitch_rate + 1.0) * (common10 * sin_roll + common5 * cos_roll - common8 * sin_roll)
    )
    y2 = f_roll_rate - K21 * f_pitch_rate
    y3 = f_yaw_rate - K31 * f_pitch_rate - K32 * y2
    x3 = y3 / D3
    x2 = y2 / D2 - K32 * x3
    x1 = f_pitch_rate / D1 - K21 * x2 - K31 * x3
    nu_rate_dot = 0.0 * nu_rate
    return pitch_rate, roll_rate, yaw_rate, nu_rate, x1, x2, x3, nu_rate_dot


def pitch_at_pericentre(state, constants):
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    return pitch


def roll_at_pericentre(state, constants):
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    return roll


def yaw_at_pericentre(state, constants):
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    return yaw


def cos_tilt(state, constants):
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    cos_roll = cos(roll)
    cos_yaw = cos(yaw)
    return cos_roll * cos_yaw
