"""Attitude of a satellite on an elliptic orbit, over the true anomaly.

Written by atlas.systems.from_lagrangian from the Lagrangian

    L = nu_rate**2/2 + (e*cos(nu) + 1)**2*(A*(roll_rate*cos(yaw) - (pitch_rate + 1)*sin(yaw)*cos(roll))**2 +
        B*(yaw_rate + (pitch_rate + 1)*sin(roll))**2 + C*(roll_rate*sin(yaw) + (pitch_rate +
        1)*cos(roll)*cos(yaw))**2)/2 - (3*e*cos(nu) + 3)*(A*(-sin(pitch)*sin(roll)*sin(yaw) +
        cos(pitch)*cos(yaw))**2 + B*sin(pitch)**2*cos(roll)**2 + C*(sin(pitch)*sin(roll)*cos(yaw) +
        sin(yaw)*cos(pitch))**2)/2

and the generalised forces

    Q_nu = e*(e*cos(nu) + 1)*(A*(roll_rate*cos(yaw) - (pitch_rate + 1)*sin(yaw)*cos(roll))**2 + B*(yaw_rate +
           (pitch_rate + 1)*sin(roll))**2 + C*(roll_rate*sin(yaw) + (pitch_rate +
           1)*cos(roll)*cos(yaw))**2)*sin(nu) - 3*e*(A*(-sin(pitch)*sin(roll)*sin(yaw) +
           cos(pitch)*cos(yaw))**2 + B*sin(pitch)**2*cos(roll)**2 + C*(sin(pitch)*sin(roll)*cos(yaw) +
           sin(yaw)*cos(pitch))**2)*sin(nu)/2
"""

from numpy import cos, sin

STATE = ("pitch", "roll", "yaw", "nu", "pitch_rate", "roll_rate", "yaw_rate", "nu_rate")
CONSTANTS = ("A", "B", "C", "e")
INTEGRALS = ()


def rhs(state, constants):
    """Time derivatives of the state."""
    pitch, roll, yaw, nu, pitch_rate, roll_rate, yaw_rate, nu_rate = state
    A, B, C, e = constants
    part1 = e * cos(nu) + 1
    cos_roll = cos(roll)
    part3 = cos_roll**2
    part4 = A * part3
    part5 = B * part3
    cos_yaw = cos(yaw)
    part7 = cos_yaw**2
    part8 = C * part7
    part9 = B + part3 * part8 - part4 * part7 + part4 - part5
    part10 = 1 / part9
    cos_pitch = cos(pitch)
    sin_pitch = sin(pitch)
    part13 = 3 * sin_pitch
    part14 = cos_yaw * sin_pitch
    sin_roll = sin(roll)
    sin_yaw = sin(yaw)
    part17 = cos_pitch * sin_yaw
    part18 = sin_pitch * sin_yaw
    part19 = cos_pitch * cos_yaw - part18 * sin_roll
    part20 = part14 * sin_roll + part17
    sin_nu = sin(nu)
    pitch_rate_plus_1 = pitch_rate + 1
    part23 = pitch_rate_plus_1 * sin_roll
    part23_plus_yaw_rate = part23 + yaw_rate
    part25 = B * part23_plus_yaw_rate
    part26 = cos_roll * pitch_rate_plus_1
    part27 = cos_yaw * part26 + roll_rate * sin_yaw
    part28 = cos_yaw * part27
    part29 = C * part28
    part30 = cos_yaw * roll_rate
    part31 = -part26 * sin_yaw + part30
    part32 = A * part31 * sin_yaw
    part33 = part27 * sin_yaw
    part34 = C * part33
    part35 = cos_yaw * part31
    part36 = A * part35
    part37 = part1 * yaw_rate
    part38 = sin_yaw**2
    part39 = A * part38
    part40 = cos_roll * part23
    part41 = part29 * sin_roll
    part42 = part1 * roll_rate
    part43 = (3 * A * part19 * (part14 + part17 * sin_roll) - 3 * C * part20 * (cos_pitch * cos_yaw * sin_roll
        - part18) - cos_pitch * part13 * part5 - cos_roll * part37 * (A * part33 + C * part35 - part34 -
        part36) + 2 * e * nu_rate * sin_nu * (cos_roll * part29 - cos_roll * part32 + part25 * sin_roll) -
        part42 * (A * part31 * sin_roll * sin_yaw + B * cos_roll * part23_plus_yaw_rate + B * cos_roll *
        pitch_rate_plus_1 * sin_roll - part39 * part40 - part40 * part8 - part41))
    part44 = B * sin_roll
    part45 = part1**2
    part46 = part10 * part45
    part47 = B**2 * sin_roll**2
    A_minus_C = A - C
    part49 = -A_minus_C
    part50 = part3 * part38 * part49**2 * part7
    part51 = 1 / (part45 * (A + C * part38 - part39) - part46 * part50)
    part52 = part1 * part49
    part53 = part10 * part43
    part54 = cos_roll * cos_yaw * sin_yaw
    part55 = (part51 * (part1 * (-A_minus_C * part1 * part23 * part30 * sin_yaw - cos_roll * part13 * (-A *
        part19 * sin_yaw + C * cos_yaw * part20 - part44 * sin_pitch) + 2 * e * nu_rate * sin_nu * (part34 +
        part36) + part1 * pitch_rate_plus_1 * (cos_roll * part25 + part32 * sin_roll - part41) - part37 * (-A
        * part28 + C * cos_yaw * part27 + C * part31 * sin_yaw - part32)) - part52 * part53 * part54))
    part56 = part49 * part54
    part57 = part10 * part56
    part58 = B * part45 * sin_roll
    part59 = ((-part1 * part44 * part53 + part1 * (-B * part26 * part42 + 2 * e * nu_rate * part25 * sin_nu -
        3 * part19 * part20 * part49 + part27 * part31 * part52) + part55 * part57 * part58) / (B * part45 -
        part1**4 * part47 * part50 * part51 / part9**2 - part46 * part47))
    part60 = part10 * part59
    part61 = part51 * part56 * part58 * part60 + part55
    return (
        pitch_rate,
        roll_rate,
        yaw_rate,
        nu_rate,
        -part44 * part60 - part57 * part61 + part10 * part43 / part1,
        part61,
        part59,
        0 + 0.0 * nu_rate,
    )


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
    return cos(roll) * cos(yaw)
