"""Wrong inputs and the sentences that answer them: rows of scenes, files of points, commands and calls.

In a sentence "..." stands for any text. Rows of extensions stand in their own tests.
"""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from refusals import assert_refused, assert_refused_in_shell, matches, unchanged_folder
from scenes import GIVEN, SAMPLE, SAMPLED, SMALL

import atlas
from atlas import load_scene
from atlas.plotting import maps
from atlas.plotting.options import MapOptions
from atlas.scene import grid

AXES = SMALL[SMALL.index("[axes") : SMALL.index("[ties]")]
LONG = 300 * "a"

# Old text, new text, the sentence, and the beginning of the line that is blamed: without it the last line of the new text
# with a value, and the file alone if it is empty.
SCENES = [
    ("count = 9", "count = -1", "axes.sigma.count = -1: must be a whole number from 1 to 10000000"),
    ("count = 9\n", "", "axes.sigma.count is missing: an axis needs from, to and count, or values", "[axes.sigma]"),
    ("A = 1.0", "A = = 1.0", "not valid TOML: Invalid value"),
    ("A = 1.0", "A = 1,0", "not valid TOML: Expected newline or end of document after a statement; the decimal sign is a point"),
    *(
        ()
        if sys.version_info >= (3, 15)  # its parser reads them
        else (
            ("A = 1.0", "x = {A = 1.0, }", "not valid TOML: ...; no comma follows the last key of a table in braces"),
            ("A = 1.0", "x = {\n  A = 1.0}", "not valid TOML: ...; a table in braces stands in one line", "x = {"),
            ("A = 1.0", "x = {A = 1.0,\n  B = 1.0}", "not valid TOML: ...; a table in braces stands in one line", "x = {"),
        )
    ),
    ("A = 1.0", "A = True", "not valid TOML: Invalid value; true and false have small letters"),
    ("A = 1.0", "A = 2 * m", 'not valid TOML: Expected newline or end of document after a statement; texts and arithmetic are quoted, such as "sigma * A"'),
    ("A = 1.0", 'A = "m"', "fixed.A = 'm': m has no value here; put what follows from other names into [ties]"),
    ("sigma * A", "sigma^2", "ties.C = 'sigma^2': 'sigma^2' is not arithmetic; powers are **; allowed: ...", 'C = "sigma^2"'),
    ("pi / 2", "arcsin(1)", "ties.psi0 = 'arcsin(1)': 'arcsin(1)' is not arithmetic; arcsin is asin, and so on; allowed: ...", 'psi0 = "arcsin(1)"'),
    ("A = 1.0", "θ = 1.0", "not valid TOML: Invalid statement; names are ASCII letters, digits and _"),
    ("A = 1.0", '"θ" = 1.0', "fixed.θ: 'θ' cannot be used as a name; allowed: ASCII letters, digits and _, ..."),
    ("from = 0.3", "from = -0.3", "ties.C = 'sigma * A' = -0.3: allowed: C > 0 (principal moment of inertia about the third body axis)", 'C = "sigma * A"'),
    ("sigma * A", "sigm * A", "ties.C = 'sigm * A': 'sigm' is neither a parameter, an axis nor a tie; did you mean 'sigma'? allowed: ...", 'C = "sigm * A"'),
    ("tolerance = 1e-5", "tolernce = 1", "integration.tolernce: unknown key; did you mean 'tolerance'? allowed: ..."),
    ("Omega = 1.0", "omega = 1.0", "fixed.omega: not a parameter of the satellite, and no tie uses it; did you mean 'Omega'? allowed: ..."),
    ('"satellite"', '"satelite"', "system = 'satelite': there is no such system; did you mean 'satellite'? allowed: satellite, fixed_point", 'system = "satelite"'),
    ("perp_velocity", "conical", "family.name = 'conical': unknown family; perp_radius, by the paper's words...", 'name = "conical"'),
    ("perp_velocity", "Hyperboloidal", "family.name = 'Hyperboloidal': unknown family; perp_velocity or asym...", 'name = "Hyperboloidal"'),
    ("perp_velocity", "perp_velocty", "family.name = 'perp_velocty': unknown family; did you mean 'perp_velocity'? allowed: ...", 'name = "perp_velocty"'),
    ("[labels]", "[lables]", "lables: unknown key; did you mean 'labels'? allowed: ...", "[lables]"),
    ("[labels]", '[outputs]\nvariables = ["lable"]\n[labels]', "outputs.variables: 'lable' is unknown; did you mean 'label'? allowed: ..."),
    ("[labels]", '[outputs]\nmap = "lable"\n[labels]', "outputs.map = 'lable': did you mean 'label'? allowed: ..."),
    ("tolerance = 1e-5", 'method = "RK4"', "integration.method = 'RK4': did you mean 'rk4'? allowed: rk4, rk8"),
    ("tolerance = 1e-5", "tolerance = 10", "integration.tolerance = 10: must be above 0 and at most 1"),
    ("duration = 30.0", 'duration = "1 day"', 'integration.duration = \'1 day\': allowed: a number of time units, "20 orbits" or "50 turns", or arithmetic such as "60 / natural_rate"'),
    ("[labels]", "[labels]\ntransient = -1.0", "labels.transient = -1.0: must be a finite number above 0"),
    ("[labels]", "[labels]\ntransient = true", "labels.transient = True: must be a number"),
    ("[labels]", "[labels]\ntransient = nan", "labels.transient = nan: must be a finite number"),
    ("[labels]", "[labels]\ntransient = [1.0]", "labels.transient = [1.0]: must be a number"),
    ("[labels]", '[labels]\ntransient = "3 days"', 'labels.transient = \'3 days\': allowed: a number of time units, "20 orbits" or "50 turns", or arithmetic such as "60 / natural_rate"'),
    ("[labels]", '[labels]\ntransient = "-5 turns"', "labels.transient = '-5 turns': must be a finite number above 0"),
    ("[labels]", '[labels]\ntransient = "tau"', "labels.transient = 'tau': 'tau' has no value at the points; ..."),
    ("[labels]", '[labels]\ntransient = "1 / k1"', "labels.transient = '1 / k1': at no point a finite time of at least 0"),
    ("schema = 1", "schema = 2", "schema = 2: allowed: 1"),
    ("schema = 1", "schema = true", "schema = True: allowed: 1"),
    ("schema = 1\n", "", "schema is missing: a scene needs schema, system and axes (or points)", ""),
    ('system = "satellite"', 'system = "sputnik"', "system = 'sputnik': there is no such system; allowed: satellite, fixed_point"),
    ('system = "satellite"', "system = 3", "system = 3: must be a string"),
    ('system = "satellite"\n', "", "system is missing: a scene needs schema, system and axes (or points)", ""),
    ('title = "small"', "colour = 3", "colour: unknown key; allowed: ..."),
    ("A = 1.0", 'A = "one"', "fixed.A = 'one': one has no value here; put what follows from other names into [ties]"),
    ("A = 1.0", "A = true", "fixed.A = True: must be a number"),
    ("A = 1.0", "A = nan", "fixed.A = nan: must be a finite number"),
    ("A = 1.0", "A = inf", "fixed.A = inf: must be a finite number"),
    ("A = 1.0", "A = -1.0", "fixed.A = -1: allowed: A > 0 (principal moment of inertia about the first body axis)"),
    ("A = 1.0", "A = 0.0", "fixed.A = 0: allowed: A > 0 (principal moment of inertia about the first body axis)"),
    ("Omega = 1.0", "Omega = -1.0", "fixed.Omega = -1: allowed: Omega >= 0 (angular velocity of the circular orbit)"),
    ("m = 0.5", "mass = 0.5", "fixed.mass: not a parameter of the satellite, and no tie uses it; allowed: ..."),
    ("count = 9", "count = 0", "axes.sigma.count = 0: must be a whole number from 1 to 10000000"),
    ("count = 9", "count = 2.5", "axes.sigma.count = 2.5: must be a whole number from 1 to 10000000"),
    ("count = 9", "count = -3", "axes.sigma.count = -3: must be a whole number from 1 to 10000000"),
    ("from = 0.3", "from = nan", "axes.sigma.from = nan: must be a finite number"),
    ("from = 0.3", "from = 1.7", "axes.sigma: from = to = 1.7 with count = 9; an axis needs distinct values", "[axes.sigma]"),
    ("from = 0.3", "from = -0.3\nspacing = 'log'", "axes.sigma.spacing = 'log': from and to must be above 0, found -0.3 and 1.7"),
    ("from = 0.3", "from = 0.3\nspacing = 'cubic'", "axes.sigma.spacing = 'cubic': allowed: linear, log"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = []", "axes.sigma.values = []: must be a list of at least one number"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = [1.0, 1.0]", "axes.sigma.values: some values occur twice; an axis needs distinct values"),
    ("from = 0.3\nto = 1.7\ncount = 9", "values = [1.0, 'two']", "axes.sigma.values = 'two': must be a number"),
    ("from = 0.3", "from = 0.3\nvalues = [1.0]", "axes.sigma.from: not together with values", "from = 0.3"),
    ("from = 0.3", "from = 0.3\nstride = 2", "axes.sigma.stride: unknown key; allowed: ..."),
    ("from = 0.3\nto = 1.7", "from = 2.3\nto = 2.5", "A + B = 2 is less than C = 2.3: no rigid body has these moments of inertia, and none of 63 points is possible", ""),
    ('B = "A"', 'B = "3 * A"', "C + A = 1.3 is less than B = 3: no rigid body has these moments of inertia, and none of 63 points is possible", ""),
    ('B = "A"', 'B = "A +"', "ties.B = 'A +': not an expression; allowed: ..."),
    ('B = "A"', 'B = "Q"', "ties.B = 'Q': 'Q' is neither a parameter, an axis nor a tie; allowed: ..."),
    ('B = "A"', 'B = "k3"', "ties.B = 'k3': k3 is only known once [family] has solved it"),
    ('B = "A"', "B = 3", 'ties.B = 3: must be a string of arithmetic, such as "sigma * A"'),
    ('B = "A"', 'B = "__import__(\'os\')"', 'ties.B = "__import__(\'os\')": "__import__(\'os\')" is not arithmetic; allowed: ...'),
    ('B = "A"', 'B = "A.real"', "ties.B = 'A.real': 'A.real' is not arithmetic; allowed: ..."),
    ('B = "A"', 'B = "1 / (A - A)"', "ties.B = '1 / (A - A)': gives inf, and no point has values of all ties"),
    ('B = "A"\n', 'B = "u"\nu = "v"\nv = "u + 1"\n', "ties refer to each other in a circle: u = 'v', v = 'u + 1'", "[ties]"),
    ('C = "sigma * A"\n', "", "axes.sigma: not a parameter of the satellite, and no tie uses it; allowed: ...", "[axes.sigma]"),
    ('name = "perp_velocity"', 'name = "banana"', "family.name = 'banana': unknown family; allowed: ..."),
    ('name = "perp_velocity"\n', "", "family.name is missing; allowed: ...", "[family]"),
    ('solve = ["k3"]', 'solve = ["Omega"]', "family.solve = 'Omega': the family perp_velocity cannot be solved for it; allowed: psi0, theta0, m, h1, h3, k3"),
    ('solve = ["k3"]', 'solve = "k3"', "family.solve = 'k3': must be a list of parameter names"),
    ('solve = ["k3"]', 'solve = ["k3", "k3"]', "family.solve = ['k3', 'k3']: a parameter is named twice"),
    ("m = 0.5", "m = 0.5\nk3 = 1.0", "k3 is given in fixed and in solve: a name has one value", ""),
    ("m = 0.5", "m = 0.5\nk1 = 0.3", "family.name = 'perp_velocity': it needs k1 = k2 = 0, which fails by 0.0487 (relative) at the nearest point of the scene", 'name = "perp_velocity"'),
    ("[nudge]\ntheta0", "[nudge]\nA", "nudge.A: unknown key; allowed: theta0, psi0, phi0, theta_dot0, n, m", "A = 1e-4"),
    ("duration = 30.0", "duration = 0.0", "integration.duration = 0.0: must be a finite number above 0"),
    ("duration = 30.0", "duration = -2", "integration.duration = -2: must be a finite number above 0"),
    ("duration = 30.0", 'duration = "20 days"', 'integration.duration = \'20 days\': allowed: a number of time units, "20 orbits" or "50 turns", or arithmetic such as "60 / natural_rate"'),
    ("duration = 30.0", 'duration = "many orbits"', 'integration.duration = \'many orbits\': allowed: a number of time units, "20 orbits" or "50 turns", or arithmetic such as "60 / natural_rate"'),
    ("tolerance = 1e-5", "tolerance = 0", "integration.tolerance = 0: must be a finite number above 0"),
    ("tolerance = 1e-5", "tolerance = true", "integration.tolerance = True: must be a number"),
    ("tolerance = 1e-5", "step = 0.0", "integration.step = 0.0: must be a finite number above 0"),
    ("tolerance = 1e-5", "step = -0.1", "integration.step = -0.1: must be a finite number above 0"),
    ("tolerance = 1e-5", "step = 0.1\ntolerance = 1e-6", "integration: step and tolerance are both given; a scene has one of them", "[integration]"),
    ("tolerance = 1e-5", 'method = "euler"', "integration.method = 'euler': allowed: rk4, rk8"),
    ("tolerance = 1e-5", "max_steps = 0", "integration.max_steps = 0: must be a whole number from 1 to 1000000000000"),
    ("tolerance = 1e-5", "max_steps = true", "integration.max_steps = True: must be a whole number from 1 to 1000000000000"),
    ("tolerance = 1e-5", "check_half_step = 'some'", "integration.check_half_step = 'some': did you mean 'sample'? allowed: none, sample, all"),
    ("rate_tolerance = 1e-3", "rate_tolerance = -1e-3", "labels.rate_tolerance = -0.001: must be a finite number above 0"),
    ("rate_tolerance = 1e-3", "rate_tolerance = nan", "labels.rate_tolerance = nan: must be a finite number"),
    ("[labels]", "[refine]\n[labels]", "refine.levels is missing: [refine] needs levels", "[refine]"),
    ("[labels]", "[refine]\nlevels = 9\n[labels]", "refine.levels = 9: must be a whole number from 1 to 8"),
    ("[labels]", "[refine]\nlevels = 2\nprobe = 1.5\n[labels]", "refine.probe = 1.5: must be a share of the points, from 0 to 1"),
    ("rate_tolerance = 1e-3", 'rate_tolerance = 1e-3\n[outputs]\nvariables = ["colour"]', "outputs.variables: 'colour' is unknown; allowed: ..."),
    ("rate_tolerance = 1e-3", "rate_tolerance = 1e-3\n[outputs]\nvariables = []", "outputs.variables = []: must be a list of at least one variable name"),
    ("schema = 1", "schema = = 1", "not valid TOML: Invalid value"),
    ("[labels]", '[about]\nauthor = "A"\n[labels]', "about.author: unknown key; did you mean 'creator'? allowed: ..."),
    ("[labels]", "[about]\nsummary = 3\n[labels]", "about.summary = 3: must be a string"),
    ("[labels]", "[about]\nkeywords = [1]\n[labels]", "about.keywords = [1]: must be a string or a list of strings"),
    ("[labels]", '[about]\ncreator = "A. Author"\n[labels]', "about.creator = 'A. Author': must be a table, [about.creator]"),
    ("[labels]", '[about.creator]\nphone = "1"\n[labels]', "about.creator.phone: unknown key; allowed: name, email, url, institution"),
    ("[labels]", '[about]\nlicense = "a"\nlicence = "b"\n[labels]', "about.licence: unknown key; did you mean 'license'? allowed: ..."),
    ("sigma * A", "sigma * normal()", "ties.C = 'sigma * normal()': 'normal()' is not arithmetic; allowed: ..., normal(draw), uniform(draw)", 'C = "sigma * normal()"'),
    ("sigma * A", "sigma * uniform(drew)", "ties.C = 'sigma * uniform(drew)': 'drew' is neither a parameter, an axis nor a tie; allowed: ...", 'C = "sigma * uniform(drew)"'),
    ("A = 1.0", 'A = "normal(1)"', "fixed.A = 'normal(1)': 'normal(1)' is not arithmetic; allowed: ..."),
    ("schema = 1", "schema = 1\nseed = -1", "seed = -1: must be a whole number from 0 to 9223372036854775807"),
    ("[ties]", '[refine]\nlevels = 1\n[axes.draw]\nfrom = 1\nto = 400\ncount = 400\n[ties]\nk1 = "normal(draw)"', "axes.draw: its values number draws, between which [refine] can interpolate nothing; list them as values = ...", "[axes.draw]"),
    ("[labels]", "[refine]\nlevels = 0\n[labels]", "refine.levels = 0: must be a whole number from 1 to 8"),
    ("[labels]", "[refine]\nlevels = 1.5\n[labels]", "refine.levels = 1.5: must be a whole number from 1 to 8"),
    ("[labels]", "[refine]\nlevels = 3\nprobe = 1.5\n[labels]", "refine.probe = 1.5: must be a share of the points, from 0 to 1"),
    ("[labels]", "[refine]\nlevels = 3\nprobe = -0.1\n[labels]", "refine.probe = -0.1: must be a share of the points, from 0 to 1"),
    ("[labels]", '[refine]\nlevels = 3\nprobe = "few"\n[labels]', "refine.probe = 'few': must be a number"),
    ("[labels]", "[refine]\nlevels = 3\nwidth = 3\n[labels]", "refine.width: unknown key; allowed: levels, probe"),
    ("schema = 1", "schema = 1\nrefine = 3", "refine = 3: must be a table, [refine]"),
    ("count = 7", "count = 7\nrefine = 3", "axes.theta0.refine: unknown key; allowed: ..."),
    ("count = 9", "count = 90000000", "axes.sigma.count = 90000000: must be a whole number from 1 to 10000000"),
    (AXES, "[axes]\nsigma.values = [1.0]\ntheta0.values = [0.4]\n[refine]\nlevels = 3\n", "refine: no axis has from, to and a count above 1, so that there is nothing to refine", "[refine]"),
    (AXES, "[axes]\n", "axes: a scene needs at least one [axes.NAME] table", "[axes]"),
    ("[ties]", '[axes.k3]\nfrom = -0.1\nto = 0.1\ncount = 3\noffset_from_family = true\n[axes.k3_offset]\nvalues = [0.0, 0.1]\n[ties]\nmu3 = "k3_offset"', "axes.k3 and axes.k3_offset would both be the dimension k3_offset of the atlas; choose another name for axes.k3_offset", "[axes.k3]"),
    ("[ties]", '[axes.point]\nvalues = [0.0, 0.1]\n[ties]\nmu3 = "point"', "axes.point: this is the dimension of scenes with [points]; choose another name", "[axes.point]"),
]  # fmt: skip

SAMPLES = [
    ('sample = "sobol"', 'sample = "random"', "points.sample = 'random': allowed: latin_hypercube, sobol"),
    ('sample = "sobol"', "", "points: needs one of sample, file and values, found none", "[points]"),
    ('sample = "sobol"', 'sample = "sobol"\nfile = "a.csv"', "points: needs one of sample, file and values, found sample and file", "[points]"),
    ("count = 48", "count = 0", "points.count = 0: must be a whole number from 1 to 10000000"),
    ("count = 48", "count = 4.0", "points.count = 4.0: must be a whole number from 1 to 10000000"),
    ("count = 48", "", "points.count is missing: [points] needs sample, count, ranges", "[points]"),
    ("seed = 3", "seed = -1", "points.seed = -1: must be a whole number from 0 to 9223372036854775807"),
    ("seed = 3", "grain = 3", "points.grain: unknown key; allowed: sample, count, seed, ranges, file, values"),
    ("from = 0.3", "", "points.ranges.sigma.from is missing: a range needs from and to", "[points.ranges.sigma]"),
    ("from = 0.3", "from = 1.7", "points.ranges.sigma: from = to = 1.7; put what does not vary into [fixed]", "[points.ranges.sigma]"),
    ("from = 0.3", "from = nan", "points.ranges.sigma.from = nan: must be a finite number"),
    ("from = 0.3", "from = 0.3\ncount = 3", "points.ranges.sigma.count: unknown key; allowed: from, to, spacing"),
    ("from = 0.02", "from = -0.02", "points.ranges.theta0.spacing = 'log': from and to must be above 0, found -0.02 and 1.4", 'spacing = "log"'),
    ('spacing = "log"', 'spacing = "cubic"', "points.ranges.theta0.spacing = 'cubic': allowed: linear, log"),
    ("ranges.sigma", "ranges.sine", "ties.C = 'sigma * A': 'sigma' is neither a parameter, an axis nor a tie; allowed: ...", 'C = "sigma * A"'),
    ('C = "sigma * A"', 'C = "A"', "points.sigma: not a parameter of the satellite, and no tie uses it; allowed: ...", "[points]"),
    ('C = "sigma * A"', 'C = "sigma * A"\ntheta0 = "0.3"', "theta0 is given in ties and in points: a name has one value", ""),
    ("from = 0.3\nto = 1.7", "from = 2.3\nto = 2.7", "A + B = 2 is less than C = 2.57976: no rigid body has these moments of inertia, and none of 48 points is possible", ""),
    ("[ties]", "[axes.k1]\nvalues = [0.0]\n[ties]", "points and axes are both given; a scene has one of them", "[points]"),
    ("[ties]", "[refine]\nlevels = 2\n[ties]", "points and refine are both given; a scene has one of them", "[points]"),
    (SAMPLE, "[points]\nvalues = 3\n", "points.values = 3: must be a table, [points.values]"),
    (SAMPLE, "[points.values]\n", "points: there are none", "[points.values]"),
    (SAMPLE, "[points.values]\nsigma = []\n", "points.values.sigma = []: must be a list of at least one number"),
    (SAMPLE, "[points.values]\nsigma = [1.0, true]\n", "points.values.sigma = True: must be a number"),
    (SAMPLE, "[points.values]\nsigma = [1.0]\ntheta0 = [1.0, 2.0]\n", "points: columns of different lengths (sigma: 1, theta0: 2)", "[points.values]"),
    (SAMPLE, "[points.values]\nsigma = [1.0]\nA = [1.0]\n", "A is given in fixed and in points: a name has one value", ""),
]  # fmt: skip

# The scene names a file, and so does the answer to what is wrong in it.
POINTS_OF_A_FILE = [
    ('file = "mine.csv"', 'file = "none.csv"', "none.csv: there is no such file", ""),
    ('file = "mine.csv"', "file = 3", "points.file = 3: must be a string"),
    ('file = "mine.csv"', 'file = "mine.csv"\nseed = 2', "points.seed: only together with sample"),
    ('C = "sigma * A"', 'C = "sigma * A"\nk1 = "q"', "ties.k1 = 'q': 'q' is neither a parameter, an axis nor a tie; allowed: ..."),
    ("A = 1.0", "A = 1.0\n[missing]", "missing: unknown key; allowed: ...", "[missing]"),
]  # fmt: skip

# Content of that file, the sentence, and the beginning of the line of the scene that is blamed.
COLUMNS = [
    ("sigma,theta0\n0.5,\n", "mine.csv, line 2: theta0 is empty or nan; must be a finite number", ""),
    ("sigma,theta0\n0.5,0.1\n\n0.5,inf\n", "mine.csv, line 4: theta0 = inf; must be a finite number", ""),
    ("sigma,theta0,colour\n0.5,0.1,3\n", "points.colour: not a parameter of the satellite, and no tie uses it; allowed: ...", "[points]"),
    ("theta0\n0.5\n", "ties.C = 'sigma * A': 'sigma' is neither a parameter, an axis nor a tie; allowed: ...", 'C = "sigma * A"'),
    ("sigma,theta0,sin\n0.5,0.1,3\n", "points: 'sin' cannot be used as a name; allowed: ASCII letters, digits and _, ...", "[points]"),
]  # fmt: skip

# Content of a file of points, and the sentence.
TABLES = [
    ("a.csv", "", "a.csv: empty; its first line must name the columns, such as C,theta0,m"),
    ("a.csv", "C,m\n", "a.csv: no points: there is only the line of names"),
    ("a.csv", "C,m\n1,2\n1\n", "a.csv, line 3: 1 fields, but the first line names 2 columns"),
    ("a.csv", "C,m\n# 1\n1,2,3\n", "a.csv, line 3: 3 fields, but the first line names 2 columns"),
    ("a.csv", "C,m\n1,2\n\n1,two\n", "a.csv, line 4: m = 'two': must be a number"),
    ("a.csv", "C,m\n1,1_0\n", "a.csv, line 2: m = '1_0': must be a number"),
    ("a.csv", "C;m\n1;0,5\n", "a.csv, line 2: m = '0,5': must be a number with a decimal point, not a comma"),
    ("a.csv", "C\n" + 1_000_001 * "1", "a.csv, line 2: more than 1000000 characters"),
    ("a.csv", "C,C\n1,2\n", "a.csv: its first line names 'C' twice: C,C"),
    ("a.csv", "C,\n1,2\n", "a.csv: its first line leaves a column without name: C,"),
    ("a.csv", "C\n\xff\xfe\n", "a.csv: not text in UTF-8"),
    ("a.csv", 'C\n"1\n', "a.csv, line 2: not a CSV file: unexpected end of data"),
    ("a.nc", "C\n1\n", "a.nc: not a NetCDF file that can be read (...)"),
    ("a.txt", "C\n1\n", "a.txt: points are read from files that end in .csv or .nc"),
    ("a.csv", "C,sigma\n1,2\n", "a.csv: sigma: not a parameter of the satellite; allowed: ..."),
    ("a.csv", "C\nnan\n", "a.csv, line 2: C is empty or nan; must be a finite number"),
    ("a.csv", "C,m\n1,1\n\n1,\n", "a.csv, line 4: m is empty or nan; must be a finite number"),
    ("a.csv", "C,m\n1,1\n1,-inf\n", "a.csv, line 3: m = -inf: must be a finite number"),
    ("a.csv", "C\n1\n-1\n", "a.csv, line 3: C = -1: allowed: C > 0 (principal moment of inertia about the third body axis)"),
    ("a.csv", "C,label,m\n0.8,first,0.5\n", "points: the column label has the name of a variable of the result; rename it"),
    ("a.csv", "who\nALPHA\n", "a.csv: none of the columns is a parameter: who; allowed: A, B, C, ..."),
    ("a.csv", "C|m\n0.8|0.5\n", "a.csv: 'C|m': understood as one column, whose name holds C, m; separate the columns, or rename it, or keep it as it is by keep"),
    ("a.csv", "c;m\n0,8;0.5\n", "a.csv: 'c': no parameter, but C if case, blanks and units do not count; rename it, or keep it as it is by keep"),
    ("a.csv", "moment;m\n0,8;0.5\n", "a.csv: 'moment': no parameter, and its texts are numbers but for decimal commas, units, quotes or separators, such as '0,8'; rename it, or keep it as it is by keep"),
    ("a.csv", "C (kg) m\n0.8 0.5\n", "a.csv, line 2: 2 fields, but the first line names 3 columns, separated by blanks: C, (kg), m"),
]  # fmt: skip

FORMS_OF_A_RUN = (
    "the name must end in .nc, for one file, in /, for a run folder, or in .zarr, for a Zarr store"
)
NEVER_REPLACED = "this is the input, which is never replaced; choose another name"
NO_JOBS = "must be JxP, J jobs of P processors such as 200x16, with --dry-run"
NO_SHARD = "must be I/N with whole numbers, 1 <= I <= N < 10^9"
NO_TIME = "must be a time such as 90s, 30m, 2h, 1h30m or 1d"
TOO_LONG = "aaa...: this name, or the path to it, is too long for the file system"

# Words after `atlas`, and the sentence; the files are those of `folder`.
COMMANDS = [
    ("run none.toml", "none.toml: there is no such file"),
    ("run small.toml -o no/folder/a.nc", "no/folder/a.nc: there is no folder no/folder"),
    ("run small.toml -o a.txt", f"a.txt: {FORMS_OF_A_RUN}"),
    ("points satellite small.toml -o a.txt", "a.txt: the name must end in .csv or .nc"),
    ("points satellite small.toml -o a.nc --threads 0", "--threads 0: must be at least 1"),
    ("trajectory small.toml -o a.txt", "a.txt: the name must end in .nc, .png, .pdf or .svg"),
    ("trajectory small.toml -o no/a.nc", "no/a.nc: there is no folder no"),
    ("accuracy small.toml -o a.txt", "a.txt: the name must end in .nc, .csv, .png, .pdf or .svg"),
    ("accuracy small.toml --points 1", "--points 1: must be at least 2"),
    ("compare none.nc --worst -3", "--worst -3: must be at least 0"),
    ("trajectory small.toml --samples 1e9", "atlas trajectory: argument --samples: invalid int value: '1e9' (see atlas trajectory --help)"),
    ("trajectory small.toml --samples 1", "--samples 1: must be at least 2"),
    ("trajectory small.toml --at sigma=1 sigma=2", "--at: sigma is given twice"),
    ("trajectory small.toml --at sigma=nan", "--at sigma=nan: must be AXIS=VALUE with a finite number..."),
    ("map small.nc --select a=1 --select a=2", "--select: a is given twice"),
    ("run small.toml -o okout", f"okout: {FORMS_OF_A_RUN}"),
    ("run small.toml -o k3_0.5", f"k3_0.5: {FORMS_OF_A_RUN}"),
    (f"run small.toml -o {LONG}.nc", TOO_LONG),
    (f"run {LONG}.toml", "aaa...: cannot be read: File name too long"),
    (f"map {LONG}.nc", TOO_LONG),
    (f"status {LONG}", TOO_LONG),
    (f"stress satellite -o {LONG}", TOO_LONG),
    ("new quikstart", "quikstart: no such example; did you mean 'quickstart'? allowed: ..."),
    ("new quickstart -o small.toml", "small.toml: this file exists; -o gives the copy another name"),
    ("new quickstart -o copy.txt", "copy.txt: the name must end in .toml"),
    ("map none.nc -o a.txt", "a.txt: the name must end in .png, .pdf or .svg"),
    ("join . -o a.nc", "...: not a run folder: there is no manifest.json in it"),
    ("stress --threads 0", "--threads 0: must be at least 1"),
    ("stress satellite -o small.toml", "small.toml: not a folder"),
    ("run small.toml --threads 0", "--threads 0: must be at least 1"),
    ("run small.toml --jobs 200x16", f"--jobs 200x16: {NO_JOBS}"),
    ("run small.toml --dry-run --jobs 200", f"--jobs 200: {NO_JOBS}"),
    ("run small.toml --dry-run --jobs 0x4", f"--jobs 0x4: {NO_JOBS}"),
    ("run small.toml -o r/ --shard 0/4", f"--shard 0/4: {NO_SHARD}"),
    ("run small.toml -o r/ --shard 5/4", f"--shard 5/4: {NO_SHARD}"),
    ("run small.toml -o a.nc --shard 1/4", "shard: a.nc is one file; shards need a run folder, a name that ends in /"),
    ("run small.toml -o r/ --scheduler tcp://127.0.0.1:9", "--scheduler tcp://127.0.0.1:9: no scheduler answers at this address (...)"),
    ("run small.toml -o r/ --scheduler banana", "--scheduler banana: no scheduler answers at this address (missing port number ...)"),
    ("run small.toml -o r/ --workers 0", "--workers 0: must be at least 1"),
    ("status .", "...: not a run folder: there is no manifest.json in it"),
    ("join none -o a.nc", ".../none: not a run folder: there is no manifest.json in it"),
    ("run small.toml --colour red", "unrecognized arguments: --colour red (see atlas --help)"),
    ("run", "atlas run: the following arguments are required: SCENE (see atlas run --help)"),
    ("check bad.toml", "bad.toml, line 14: axes.sigma.count = -9: must be a whole number from 1 to 10000000"),
    ("compare small.toml", "small.toml: this is a scene, not an atlas; `atlas run small.toml` makes its atlas"),
    ("compare ''", "ATLAS: must not be empty"),
    ("compare none.nc ''", "OTHER: must not be empty"),
    ("map none.nc -o ''", "--out: must not be empty"),
    ("map none.nc --select ''", "--select: must not be empty"),
    ("run ''", "SCENE: must not be empty"),
    ("map none.nc", "none.nc: there is no such file"),
    ("fly", "argument COMMAND: 'fly': allowed: ... (see atlas --help)"),
    ("rum", "argument COMMAND: 'rum': did you mean 'run'? allowed: ... (see atlas --help)"),
    ("", "the following arguments are required: COMMAND (see atlas --help)"),
    ("map atlas.nc -o b.png --colors drifting", "--colors drifting: must be NAME=TEXT"),
    ("map atlas.nc -o b.png --colors drifting=red --colors drifting=blue", "--colors: drifting is given twice"),
    ("map atlas.nc -o b.png --size 100", "--size 100: must be WIDTHxHEIGHT in mm, such as 120x90"),
    ("map atlas.nc -o b.png --dpi 0", "dpi = 0.0: must be a number from 10 to 2400"),
    ("map atlas.nc -o b.png --cmap magma", "cmap: label has flags, each with a colour of its own; choose them by colors"),
    ("run small.toml -o old.nc", "old.nc: this file exists; --force replaces it"),
    ("points satellite small.toml -o old.nc", "old.nc: this file exists; --force replaces it"),
    ("trajectory small.toml -o old.nc", "old.nc: this file exists; --force replaces it"),
    ("accuracy small.toml -o old.nc", "old.nc: this file exists; --force replaces it"),
    ("map atlas.nc -o old.png", "old.png: this file exists; --force replaces it"),
    ("stress satellite -o .", ".: these files exist; --force replaces them: satellite.png"),
    ("points satellite in.csv -o in.csv --force", f"in.csv: {NEVER_REPLACED}"),
    ("points satellite in.csv -o folder/../in.csv --force", f"folder/../in.csv: {NEVER_REPLACED}"),
    ("points satellite in.csv -o link.csv --force", f"link.csv: {NEVER_REPLACED}"),
    ("points satellite link.csv -o in.csv --force", f"in.csv: {NEVER_REPLACED}"),
    ("run scene.nc --force", f"scene.nc: {NEVER_REPLACED}"),
    ("run scene.nc -o link.nc --force", f"link.nc: {NEVER_REPLACED}"),
    ("run with_points.toml -o points.nc --force", f"points.nc: {NEVER_REPLACED}"),
    ("trajectory with_points.toml -o points.nc --force", f"points.nc: {NEVER_REPLACED}"),
    ("accuracy with_points.toml -o points.nc --force", f"points.nc: {NEVER_REPLACED}"),
    ("accuracy with_points.toml -o a.csv points.nc --force", f"points.nc: {NEVER_REPLACED}"),
    ("map figure.png -o figure.png --force", f"figure.png: {NEVER_REPLACED}"),
    ("trajectory small.toml --at sigma=0.5 -o b.nc", "theta0: has no value; a trajectory needs a value of every axis: sigma, theta0"),
    ("trajectory small.toml --at sigma=0.5 theta0=0.7 k3=1 -o b.nc", "k3: is no axis of the scene; a trajectory needs a value of every axis: sigma, theta0"),
    ("trajectory small.toml --at sigma=half theta0=0.7 -o b.nc", "--at sigma=half: must be AXIS=VALUE with a finite number, or arithmetic such as..."),
    ("points satellite in.csv -o out.nc --threads 0", "--threads 0: must be at least 1"),
    ("points satellite in.csv -o out.nc --duration -3", "duration = -3: must be a finite number above 0"),
    ("points satellite in.csv -o out.nc --transient -3", "transient = -3.0: must be a finite number above 0"),
    ("points satellite in.csv -o out.nc --tolerance 0", "tolerance = 0.0: must be a finite number above 0"),
    ("points satellite in.csv -o out.nc --method euler", "method = 'euler': allowed: rk4, rk8"),
    ("points satellite in.csv -o out.nc --step 0.1 --tolerance 1e-3", "atlas points: argument --tolerance: not allowed with argument --step (see atlas points --help)"),
    ("points satellite in.csv -o out.nc -o no/out.nc", "no/out.nc: there is no folder no"),
    ("points satellite in.csv -o out.nc -o out.txt", "out.txt: the name must end in .csv or .nc"),
    ("run small.toml -o a.nc --stop-after=2", f"--stop-after 2: {NO_TIME}"),
    ("run small.toml -o a.nc --stop-after=h", f"--stop-after h: {NO_TIME}"),
    ("run small.toml -o a.nc --stop-after=-1h", f"--stop-after -1h: {NO_TIME}"),
    ("run small.toml -o a.nc --stop-after=1.5h", f"--stop-after 1.5h: {NO_TIME}"),
    ("run small.toml -o a.nc '--stop-after=2h 3m'", f"--stop-after 2h 3m: {NO_TIME}"),
    ("run small.toml -o a.nc --stop-after=0s", "stop_after = 0.0: must be a number of seconds above 0"),
    ("compare atlas.nc -o c.png", "-o: only of two atlases; atlas map --variable agreement draws the comparison with theory"),
    ("compare atlas.nc atlas.nc -o atlas.nc --force", f"atlas.nc: {NEVER_REPLACED}"),
    ("compare atlas.nc atlas.nc -o c.txt", "c.txt: the name must end in .nc, .png, .pdf or .svg"),
    ("check none.toml", "none.toml: there is no such file"),
    ("check folder", "folder: this is a folder"),
    ("check binary.toml", "binary.toml: not text in UTF-8"),
    ("points satellite in.csv -o out.csv --keep m", "keep: 'm' is a parameter, which the result contains anyhow"),
    ("points satellite in.csv -o out.csv --keep trail", "keep: 'trail' is no column of the points"),
    ("extend atlas.nc small.toml -o atlas.nc --force", f"atlas.nc: {NEVER_REPLACED}"),
    ("map atlas.nc --select sigma=9", "sigma = 9: outside the atlas; allowed: 0.3 to 1.7"),
    ("compare atlas.nc --worst -1", "--worst -1: must be at least 0"),
]  # fmt: skip

ON_X = xr.DataArray([1.0, 2.0], dims="x", coords={"x": [0, 1]})
NO_NUMBER = "must be a number or an array of numbers"
NO_SCENE = "must be the path of a scene file, the text of one, a dictionary of its keys, or a Scene of atlas.load_scene"
SEVERAL_PLACES = "arrays of different points: cannot ..."
# Of example-robot-data #130: its diagonal alone is that of a body.
NOT_WRITTEN = "is masked or was never written; must be a finite number"
SCENE_LOST = "the scene of this atlas is lost: another program emptied its attribute atlas_scene"
MASKED = np.ma.array([0.8, 1.2, 1.4], mask=[0, 1, 0])


class LazyTable:
    """A table as the lazy ones of polars, which have no length and warn when they are asked for names of columns."""

    @property
    def columns(self):
        warnings.warn("expensive", stacklevel=2)
        return ["C"]

    def __getitem__(self, name):
        raise TypeError("not subscriptable")


class ArrowTable(LazyTable):
    """A table as those of pyarrow, whose columns are arrays."""

    columns, column_names = (np.ones(2),), ("C",)

    def __len__(self):
        return 2


# A call, and the sentence. `ds` is the atlas of the small scene, `points` that of two points of `label_points`.
CALLS = [
    (lambda ds, points: atlas.open_atlas("truncated.nc"), "truncated.nc: not a NetCDF file that can be read (...)"),
    (lambda ds, points: atlas.open_atlas("old.nc"), "old.nc: not a NetCDF file that can be read (...)"),
    (lambda ds, points: atlas.open_atlas("empty.nc"), "empty.nc: not a NetCDF file that can be read (...)"),
    (lambda ds, points: atlas.open_atlas("points.nc"), "points.nc: not an atlas: the attribute atlas_system is missing"),
    (lambda ds, points: atlas.open_atlas("none.nc"), "none.nc: there is no such file"),
    (lambda ds, points: atlas.open_atlas("."), "...: not a run folder: there is no manifest.json in it"),
    (lambda ds, points: ds.atlas.select(), "select: name at least one flag, such as label='drifting'"),
    (lambda ds, points: ds.atlas.select(label="drift"), "label = 'drift': did you mean 'drifting'? allowed: not_computed, regular_precession, ..."),
    (lambda ds, points: ds.atlas.select(theta_dot_rms="drifting"), "theta_dot_rms: not a flag variable of this atlas; allowed: ..."),
    (lambda ds, points: ds.atlas.fractions("step"), "step: not a flag variable of this atlas; did you mean 'stable'? allowed: ..."),
    (lambda ds, points: ds.atlas.fractions(along="k3"), "along = 'k3': not an axis of this atlas; allowed: sigma, theta0"),
    (lambda ds, points: ds.atlas.probability("step", over="sigma"), "step: not a flag variable of this atlas; ..."),
    (lambda ds, points: ds.atlas.probability(over=["sigma", "draw"]), "over = 'draw': not an axis of this atlas; allowed: sigma, theta0"),
    (lambda ds, points: ds.atlas.nearest(k3=0.2), "k3: not an axis of this atlas; allowed: sigma, theta0"),
    (lambda ds, points: ds.atlas.nearest(sigma=9.0), "sigma = 9: outside the atlas; allowed: 0.3 to 1.7"),
    (lambda ds, points: ds.atlas.trajectory(sigma=1.0), "theta0: has no value; a trajectory needs a value of every axis: sigma, theta0"),
    (lambda ds, points: ds.atlas.boundary("wandering"), "label = 'wandering': allowed: not_computed, ..."),
    (lambda ds, points: ds.atlas.trust("step"), "step: not a flag variable of this atlas; ..."),
    (lambda ds, points: points.atlas.families(), "families: these points come from no scene, so that there are no axes"),
    (lambda ds, points: points.atlas.nearest(sigma=2.0), "sigma: does not vary over these points; allowed: theta0"),
    (lambda ds, points: points.atlas.trajectory(), "trajectory: these are several points; name the point by values of its parameters"),
    (lambda ds, points: xr.Dataset().atlas.cite(), "not an atlas: the attribute atlas_system is missing"),
    (lambda ds, points: atlas.systems.describe("satelite"), "system = 'satelite': there is no such system; did you mean 'satellite'? allowed: satellite, fixed_point"),
    (lambda ds, points: atlas.figure([]), "panels: must have at least one atlas"),
    (lambda ds, points: atlas.figure(3), "panels: 0 = 3: must be an atlas, or an atlas and a variable"),
    (lambda ds, points: atlas.figure({"a": (ds, "label", 2)}), "panels: a = ...: must be an atlas, or an atlas and a variable"),
    (lambda ds, points: atlas.figure([(ds, "lable")]), "lable: not a variable of this atlas; did you mean 'label'? allowed: ..."),
    (lambda ds, points: atlas.figure([ds] * 13), "these are 13 panels; allowed: at most 12"),
    (lambda ds, points: atlas.figure([ds, ds], ax=Figure().subplots()), "ax: 2 panels do not fit into one; choose one by select"),
    (lambda ds, points: atlas.figure([ds], columns=0), "columns = 0: must be a whole number from 1 to 12"),
    (lambda ds, points: atlas.figure([ds], row="theta0", columns=2), "columns: not together with row, whose panels are below each other"),
    (lambda ds, points: atlas.figure([ds, (ds, "theta_max")], labels={"mu": "x"}), "labels: 'mu': allowed: ..."),
    (lambda ds, points: atlas.style("poster"), "width = 'poster': allowed: column, page, or 20 to 2000 mm"),
    (lambda ds, points: ds.atlas.map(width=5), "width = 5: allowed: column, page, or 20 to 2000 mm"),
    (lambda ds, points: ds.expand_dims(run=2).atlas.map(), "run: has no numbers as coordinate; choose one by isel, or draw names by col='run'"),
    (lambda ds, points: ds.expand_dims(run=list("abcdefghijklm")).atlas.map(col="run"), "run are 13 panels; allowed: at most 12"),
    (lambda ds, points: ds.atlas.compare(3), "other = 3: must be the dataset of an atlas"),
    (lambda ds, points: ds.atlas.compare(ds.isel(sigma=slice(3))), "these atlases are not on the same grid: sigma has 9 and 3 values"),
    (lambda ds, points: ds.atlas.compare(ds.isel(sigma=0)), "these atlases are not on the same grid: sigma has 9 and 0 values"),
    (lambda ds, points: ds.atlas.compare(ds.assign_coords(theta0=ds.theta0 + 1e-9)), "these atlases are not on the same grid: theta0 has other values"),
    (lambda ds, points: ds.atlas.compare(ds.assign_attrs(atlas_system="fixed_point")), "these atlases are not on the same grid: the systems are satellite and fixed_point"),
    (lambda ds, points: points.atlas.compare(points.assign_coords(theta0=("point", [0.4, 0.8]))), "these atlases are not on the same grid: point has other values"),
    (lambda ds, points: ds.atlas.compare(ds.assign(label=(ds.label + np.int8(5)).assign_attrs(ds.label.attrs))), "label: damaged: not the flags of an atlas, 0 to 4..."),
    (lambda ds, points: atlas.run(SMALL, stop_after=1.0), "shard, scheduler, workers and stop_after need an out that ends in /, .zarr or .nc"),
    (lambda ds, points: atlas.trajectory("satellite", {"C": 3.0}), "A + B = 2 is less than C = 3: no rigid body has these moments of inertia"),
    *(
        (lambda ds, points, what=what: atlas.run(what), f"scene: found {what!r}; {NO_SCENE}")
        for what in (3, None, ["a.toml"])
    ),
    *(
        (lambda ds, points, given=given: atlas.label_points("satellite", given), sentence)
        for given, sentence in (
            ({"C": xr.DataArray([1.0, 1.2], dims="x"), "m": xr.DataArray([1.0, 2.0, 3.0], dims="x")}, SEVERAL_PLACES),
            ({"C": ON_X, "m": ON_X.assign_coords(x=[0, 2])}, SEVERAL_PLACES),
            ({"C": ["1", "1.2"]}, f"C = ['1', '1.2']: {NO_NUMBER}"),
            ({"C": np.array(["1"], object)}, f"C = array(['1'], dtype=object): {NO_NUMBER}"),
            ({"C": [True, False]}, f"C = [True, False]: {NO_NUMBER}"),
            ({"C": np.ones((2, 2))}, "C: an array of 2 dimensions; give a DataArray, whose dimensions have names (its shape: (2, 2))"),
            ({"C": xr.DataArray(["a"], dims="x")}, f"C = <xarray.DataArray (x: 1)>...: {NO_NUMBER}"),
            ({"m": 10**400}, f"m = an integer of 401 digits: {NO_NUMBER}"),
            ({"c": xr.DataArray([1.0], dims="x")}, "c: not a parameter of the satellite; did you mean 'C'? allowed: ..."),
            (xr.Dataset({"m": 1.0}, coords={"c": [1.0, 1.2]}), "c: no parameter varies along it; did you mean 'C'? allowed: ..."),
            ({"C": ON_X.assign_coords(label=("x", [0, 1]))}, "points: the column label has the name of a variable of the result; rename it"),
            ({"C": xr.DataArray(np.ones((2, 2)), dims=("C", "m"), coords={"C": [1.0, 1.2]})}, "C: an index of the points has the name of this parameter and other values"),
            ({"mass": 1.0}, "mass: not a parameter of the satellite; allowed: ..."),
            ({"A": -1.0}, "A = -1: allowed: A > 0 (principal moment of inertia about the first body axis)"),
            ({"A": np.nan}, "A = nan: must be a finite number"),
            ({"A": "one"}, f"A = 'one': {NO_NUMBER}"),
            ({"A": [[1.0]]}, "A: an array of 2 dimensions; give a DataArray, whose dimensions have names (its shape: (1, 1))"),
            ({"A": [1.0, 2.0], "B": [1.0, 2.0, 3.0]}, "points: columns of different lengths (A: 2, B: 3)"),
            ({"theta0": []}, "points: there are none"),
            ({"C": [0.8, 1.2], "name": ["a", "b", "c"]}, "points: columns of different lengths (C: 2, name: 3)"),
            ([{"C": 1.0}, {"m": 1.0}], "points: number 1 and number 0 differ in C, m"),
            ([], "points: there are none"),
            ({"name": ["a", "b"]}, "none of the columns is a parameter: name; allowed: A, B, C, ..."),
            (xr.Dataset({"m": ("c", [1.0, 2.0])}, {"c": [0.8, 1.2]}), "'c': no parameter, but C if case, blanks and units do not count; rename it, or keep it as it is by keep"),
            (3.0, "points: float cannot be read; allowed: ..."),
            (LazyTable(), "points: LazyTable cannot be read; allowed: ..."),
            (ArrowTable(), "points: ArrowTable cannot be read; allowed: ..."),
            ({"C": MASKED, "m": 0.5}, f"point 1 (counted from 0): C {NOT_WRITTEN}"),
            ({"C": 0.9, "psi0": MASKED}, f"point 1 (counted from 0): psi0 {NOT_WRITTEN}"),
            ({"C": np.ma.masked}, f"C {NOT_WRITTEN}"),
            ([{"C": 0.8}, {"C": np.ma.masked}], f"point 1 (counted from 0): C {NOT_WRITTEN}"),
            (Path("unwritten.nc"), f"point 1 (counted from 0): C {NOT_WRITTEN}"),
            (Path("none.csv"), "none.csv: there is no such file"),
            (Path("folder.csv"), "folder.csv: this is a folder"),
            (Path("plane.nc"), "plane.nc: ...x, y..."),
        )
    ),
    *(
        (lambda ds, points, options=options: atlas.label_points("satellite", {"m": [1.0, 2.0]}, **options), sentence)
        for options, sentence in (
            ({"duration": -1.0}, "duration = -1: must be a finite number above 0"),
            ({"duration": [1.0, 2.0, 3.0]}, "points: columns of different lengths (m: 2, duration: 3)"),
            ({"transient": -1.0}, "transient = -1.0: must be a finite number above 0"),
            ({"transient": True}, "transient = True: must be a number or a text"),
            ({"transient": [1.0]}, "transient = [1.0]: must be a number or a text"),
            ({"transient": "x"}, "transient = 'x': 'x' has no value at the points; ..."),
            ({"transient": "1 / k1"}, "transient is no finite time of at least 0"),
            ({"method": "euler"}, "method = 'euler': allowed: rk4, rk8"),
            ({"step": 0.0}, "step = 0.0: must be a finite number above 0"),
            ({"colour": 1}, "colour: unknown option of label_points; allowed: duration, step, ..."),
        )
    ),
    (lambda ds, points: atlas.label_points("satellite", xr.open_dataset("unwritten.nc")), f"point 1 (counted from 0): C {NOT_WRITTEN}"),
    (lambda ds, points: atlas.label_points("satellite", xr.open_dataset("unwritten.nc")[["m"]]), f"point 2 (counted from 0): m {NOT_WRITTEN}"),
    (lambda ds, points: atlas.label_points("satellite", {"m": 1.0}, duration=MASKED), f"point 1 (counted from 0): duration {NOT_WRITTEN}"),
    (lambda ds, points: atlas.trajectory("satellite", {"theta0": MASKED[1]}), f"theta0 {NOT_WRITTEN}"),
    (lambda ds, points: load_scene({"schema": 1, "system": "satellite", "axes": {"C": {"values": MASKED}}}), f"...point 1 (counted from 0): axes.C.values {NOT_WRITTEN}"),
    (lambda ds, points: load_scene({"schema": 1, "system": "satellite", "points": {"values": {"C": MASKED}}}), f"...point 1 (counted from 0): points.values.C {NOT_WRITTEN}"),
    (lambda ds, points: load_scene(Path("unwritten.toml")), f"...point 1 (counted from 0): points.values.C {NOT_WRITTEN}"),
    (lambda ds, points: ds.atlas.nearest(sigma=np.ma.masked), f"sigma {NOT_WRITTEN}"),
    (lambda ds, points: ds.assign_attrs(atlas_scene="").atlas.trajectory(sigma=1.0, theta0=0.3), SCENE_LOST),
    (lambda ds, points: ds.assign_attrs(atlas_scene="").atlas.families(), SCENE_LOST),
    (lambda ds, points: ds.assign_attrs(atlas_scene="").atlas.boundary(), SCENE_LOST),
    (lambda ds, points: ds.assign_attrs(atlas_scene="").isel(sigma=0).rename(theta0="point").atlas.trajectory(sigma=1.0), SCENE_LOST),
    (lambda ds, points: atlas.open_atlas("format2.zarr"), "...format2.zarr: a Zarr store of format 2; atlases have format 3"),
    (lambda ds, points: atlas.label_points("satellite", {"C": 1.2}, tolerence=1e-5), "tolerence: unknown option of label_points; did you mean 'tolerance'? allowed: duration, step, ..."),
    (lambda ds, points: atlas.label_points("satellite", {"m": 1.0}, tolerance=np.float64(-1.0)), "tolerance = -1.0: must be a finite number above 0"),
    (lambda ds, points: atlas.label_points("satellite", {"m": 1.0}, duration=np.array([-1.0])), "duration = -1: must be a finite number above 0"),
    (lambda ds, points: atlas.label_points("fixed_point", {"m": 1.0}, duration="1 orbit"), "duration = '1 orbit': the fixed_point has no orbit; use time units or turns"),
    (lambda ds, points: atlas.label_points("fixed_point", {"m": 1.0}, transient="1 orbit"), "transient = '1 orbit': the fixed_point has no orbit; use time units or turns"),
    (lambda ds, points: atlas.label_points("satellite", {"m": [0.0, 0.0]}, duration="1 turn"), "duration = '1 turn', but n and m are 0, and nothing turns; give a number of time units"),
    *(
        (lambda ds, points, options=options: maps.atlas_map(ds, **options), f"...{words}...")
        for options, words in (
            ({"variable": "lable"}, "lable: not a variable"),
            ({"x": "k3"}, "x = 'k3': not an axis"),
            ({"x": "sigma", "y": "sigma"}, "x = y"),
            ({"select": {"k3": 1.0}}, "k3: not an axis"),
            ({"row": "k3"}, "row = 'k3': not an axis"),
            ({"x": "sigma", "col": "sigma"}, "x = col = 'sigma': each must be another axis"),
            ({"select": {"sigma": 7.0}}, "sigma = 7: outside the atlas; allowed: 0.3 to 1.7"),
            ({"select": {"sigma": float("nan")}}, "must be a finite number"),
            ({"select": {"sigma": 1.0, "theta0": 1.0}}, "no axes to draw"),
            ({"width": "poster"}, "allowed: column, page"),
            ({"size": 100}, "size = 100: must be width and height in mm"),
            ({"size": (100, 1e9)}, "must be width and height in mm"),
            ({"dpi": 0}, "dpi = 0: must be a number from 10 to 2400"),
            ({"cmap": "viridis"}, "cmap: label has flags"),
            ({"variable": "theta_dot_rms", "cmap": "rainbows"}, "no such colour map"),
            ({"variable": "theta_dot_rms", "colors": {"drifting": "red"}}, "colors: theta_dot_rms has no flags"),
            ({"colors": {"drift": "red"}}, "colors: 'drift': did you mean 'drifting'? allowed: not_computed"),
            ({"colors": {"drifting": "reddish"}}, "not a colour of Matplotlib"),
            ({"colors": ["red"]}, "colors = ['red']: must be a mapping"),
            ({"labels": {"k3": "x"}}, "labels: 'k3': allowed: "),
            ({"ax": 3}, "ax = 3: must be Axes"),
        )
    ),
    *(
        (lambda ds, points, options=options: ds.assign(theta_dot_rms=xr.ones_like(ds.theta_dot_rms)).atlas.map(**{"variable": "theta_dot_rms"} | options), f"...{words}...")
        for options, words in (
            ({"vmax": "90"}, "vmax = '90': must be a number"),
            ({"vmin": np.nan}, "vmin = nan: must be a finite number"),
            ({"vmin": 2, "vmax": 1}, "vmin = 2: must be below vmax = 1"),
            ({"vmin": 9.0}, "vmin: beyond the values of theta_dot_rms, which are from 0.5 to 1.5"),
            ({"norm": "logarithmic"}, "norm = 'logarithmic': allowed: linear, log, symlog, asinh, or a norm of Matplotlib"),
            ({"norm": Normalize(), "vmin": 1}, "norm: a norm of Matplotlib has vmin and vmax of its own"),
            ({"norm": "log", "vmin": -1}, "norm = 'log': theta_dot_rms from -1 to 1.5 is not above 0"),
            ({"variable": "label", "vmin": 1}, "vmin: label has flags"),
            ({"variable": "label", "norm": "log"}, "norm: label has flags"),
            ({"vmaks": 1}, "map: vmaks: no such option; did you mean 'vmax'? allowed: variable, x, y, row, "),
        )
    ),
    *(
        (lambda ds, points, options=options: MapOptions(**options), f"...{words}...")
        for options, words in (
            ({"size": 70}, "size = 70: must be width and height"),
            ({"size": (70, 60, 50)}, "must be width and height"),
            ({"size": (70, "60")}, "must be width and height"),
            ({"dpi": True}, "dpi = True: must be a number from 10 to 2400"),
            ({"width": "poster"}, "width = 'poster': allowed: column, page"),
            ({"colors": {"drifting": "no colour"}}, "'drifting' = 'no colour': not a colour"),
        )
    ),
    *(
        (lambda ds, points, function=function, options=options: function("satellite", {"Omega": 1.0}, **options), f"...{words}...")
        for function in (atlas.label_points, atlas.trajectory)
        for options, words in (
            ({"duration": "60 / Omgea"}, "duration = '60 / Omgea': 'Omgea' has no value at the points; did you mean 'Omega'?"),
            ({"rate_tolerance": "1e-4 * x"}, "rate_tolerance = '1e-4 * x': 'x' has no value at the points; allowed: A, "),
            ({"rate_tolerance": "-1e-4"}, "rate_tolerance = -0.0001: must be a finite number above 0"),
            ({"rate_tolerance": "1e-4 *"}, "rate_tolerance = '1e-4 *': not an expression"),
            ({"duration": "-1 * Omega"}, "duration = '-1 * Omega', but it is no finite number above 0"),
            ({"rate_tolerance": "0 * Omega"}, "rate_tolerance is no finite number above 0"),
        )
    ),
    *(
        (lambda ds, points, options=options: load_scene(atlas.example("quickstart", **options)), f"{words}...")
        for options, words in (
            ({"axes": {"n": {"count": 0}}}, "axes.n.count = 0: "),
            ({"axes": {"n": {"cuont": 3}}}, "axes.n.cuont: unknown key; did you mean 'count'?"),
            ({"fixed": {3: 1.0}}, "fixed: the key 3 must be a text"),
            ({"fixed": {"A": None, "B": {1.0}}}, "fixed.B = {1.0}: must be a text, a number"),
            ({"fixed": {"B": 1 + 2j}}, "fixed.B = (1+2j): must be a text, a number"),
            ({"axes": {"n": {"values": [1.0, None]}}}, "axes.n.values = None: must be a text, a number"),
            ({"system": "satelite"}, "system = 'satelite'"),
            ({"no_key": 1}, "no_key: unknown key"),
            ({"schema": None}, "schema is missing"),
        )
    ),
    (lambda ds, points: ds.atlas.map(title=3), "...title = 3: must be a text..."),
    (lambda ds, points: ds.atlas.map(size=1.5), "...size = 1.5: must be a tuple..."),
    (lambda ds, points: ds.atlas.map(select=...), "...select = Ellipsis: must be a mapping..."),
    (lambda ds, points: ds.atlas.map(x=np.ones(2)), "...x = ...: must be a text..."),
    (lambda ds, points: ds.atlas.fractions([]), "...variable = []: must be a text..."),
    (lambda ds, points: ds.atlas.boundary(["drifting"]), "...label = ...: must be a text or a whole number..."),
    (lambda ds, points: ds.atlas.nearest(sigma=...), "...sigma = Ellipsis: must be a finite number..."),
    (lambda ds, points: atlas.open_atlas(3), "...path = 3: must be a text or a path..."),
    (lambda ds, points: atlas.run(ds.atlas_scene, threads="a"), "...threads = 'a': must be a whole number..."),
    (lambda ds, points: atlas.run(ds.atlas_scene, "r/", shard=np.ones(2)), "...shard = ...: must be a tuple..."),
    (lambda ds, points: atlas.run(ds.atlas_scene, "r/", shard=(2, 1)), "...shard: i = 2: must be a whole number from 1 to 1..."),
    (lambda ds, points: atlas.label_points("satellite", {"m": 1.0}, threads=-1), "...threads = -1: must be a whole number..."),
    (lambda ds, points: atlas.label_points("satellite", {"m": 1.0}, keep=3), "...keep = 3: must be a string or a list..."),
    (lambda ds, points: atlas.label_points("satellite", {"name": ["ALPHA", "BETA"]}, duration=5.0), "...none of the columns is a parameter: ..."),
    (lambda ds, points: atlas.label_points("satellite", pd.DataFrame({"date": ["2026-01-05"], "id": [3]}), duration=5.0), "...none of the columns is a parameter: ..."),
    (lambda ds, points: atlas.label_points("satellite", pd.DataFrame({"date": ["2026-01-05"], "id": [3]}).iloc[0], duration=5.0), "...none of the columns is a parameter: ..."),
    (lambda ds, points: atlas.label_points("satellite", pd.DataFrame(index=["ALPHA", "BETA"]), duration=5.0), "...none of the columns is a parameter: ..."),
]  # fmt: skip


def starts(rows):
    """Names of rows: the first words of their sentences."""
    return [row[-1 if len(row) == 2 else 2][:40] for row in rows]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with scenes, an atlas, tables of points, links, and files that a command could replace."""
    path = tmp_path_factory.mktemp("folder")
    (path / "small.toml").write_text(SMALL)
    (path / "bad.toml").write_text(SMALL.replace("count = 9", "count = -9"))
    (path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (path / "scene.nc").write_text(SMALL)
    (path / "link.nc").hardlink_to(path / "scene.nc")
    (path / "with_points.toml").write_text('schema = 1\nsystem = "satellite"\npoints.file = "points.nc"\n')
    (path / "in.csv").write_text("C,m\n1,0.5\n")
    (path / "link.csv").symlink_to("in.csv")
    (path / "folder").mkdir()
    (path / "folder.csv").mkdir()
    xr.Dataset({"m": ("point", [0.5])}).to_netcdf(path / "points.nc")
    xr.Dataset({"C": (("x", "y"), np.ones((2, 2)))}).to_netcdf(path / "plane.nc")
    with netCDF4.Dataset(path / "unwritten.nc", "w") as file:
        file.createDimension("point", 3)
        file.createVariable("C", "f4", "point")[[0, 2]] = 0.8, 1.2
        file.createVariable("m", "i4", "point")[:2] = 1, 2
    (path / "unwritten.toml").write_text('schema = 1\nsystem = "satellite"\npoints.file = "unwritten.nc"\n')
    (path / "format2.zarr").mkdir()
    (path / "format2.zarr" / ".zgroup").write_text('{"zarr_format": 2}')
    (path / "old.nc").write_text("a damaged atlas, by its atlas_version")
    for name in ("old.png", "figure.png", "satellite.png"):
        (path / name).write_text("kept")
    atlas.run(load_scene(SMALL), path / "atlas.nc", progress=False).close()
    content = (path / "atlas.nc").read_bytes()
    (path / "truncated.nc").write_bytes(content[: len(content) // 2])
    (path / "empty.nc").write_bytes(b"")
    return path


@pytest.fixture(scope="module")
def datasets(folder):
    """The atlas of the small scene, and that of two points."""
    points = atlas.label_points("satellite", {"theta0": [0.4, 0.9]}, duration=1.0, step=0.1)
    with atlas.open_atlas(folder / "atlas.nc") as ds:
        yield ds.load(), points


def refuse_scene(text: str, place: str, sentence: str, capsys) -> None:
    """A scene is refused as a text, and with its file and line by `atlas check` and whoever reads the file."""
    Path("scene.toml").write_text(text, encoding="utf-8")
    lines = [number for number, line in enumerate(text.splitlines(), 1) if place and line.startswith(place)]
    located = f"scene.toml, line {lines[0]}: {sentence}" if place else f"scene.toml: {sentence}"
    assert_refused_in_shell("check scene.toml", located, capsys)
    if "file = " not in text:  # which only a file may name
        assert_refused(
            lambda: grid.check(load_scene(text)),
            located.replace("scene.toml", "scene") if "TOML" in sentence else sentence,
        )


@pytest.mark.parametrize(
    ("base", "row"),
    [
        (base, row)
        for base, rows in ((SMALL, SCENES), (SAMPLED, SAMPLES), (GIVEN, POINTS_OF_A_FILE))
        for row in rows
    ],
    ids=starts([*SCENES, *SAMPLES, *POINTS_OF_A_FILE]),
)
def test_a_mistake_in_a_scene(base, row, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text("sigma,theta0\n0.5,0.3\n")
    old, new, sentence, *place = row
    assert old in base
    place = place or [line for line in new.splitlines() if "=" in line][-1:]
    refuse_scene(base.replace(old, new, 1), place[0], sentence, capsys)


@pytest.mark.parametrize(("content", "sentence", "place"), COLUMNS, ids=starts(COLUMNS))
def test_a_mistake_in_the_file_of_a_scene(content, sentence, place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text(content)
    refuse_scene(GIVEN, place, sentence, capsys)


@pytest.mark.parametrize(("name", "content", "sentence"), TABLES, ids=starts(TABLES))
def test_a_mistake_in_a_file_of_points(name, content, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(content, encoding="latin-1")
    with unchanged_folder():
        assert_refused(lambda: atlas.label_points("satellite", name), sentence)
    assert_refused_in_shell(f"points satellite {name} -o out.nc", sentence, capsys)


@pytest.mark.parametrize(("command", "sentence"), COMMANDS, ids=lambda text: text[:40])
def test_a_mistake_in_a_command(command, sentence, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert_refused_in_shell(command, sentence, capsys)


# Settings of other programs, which they read when they are imported.
ENVIRONMENTS = [
    ("NUMBA_DISABLE_JIT=1", "run small.toml -o new.nc", "NUMBA_DISABLE_JIT is set: nothing can be integrated without compiled kernels; unset it"),
    ("NUMBA_DISABLE_JIT=1", "points satellite in.csv -o new.nc", "NUMBA_DISABLE_JIT is set: nothing can be integrated without compiled kernels; unset it"),
    ("NUMBA_NUM_THREADS=0", "run small.toml -o new/", "Numba cannot be used: Number of threads specified must be > 0. (NUMBA_NUM_THREADS=0)"),
    ("MPLBACKEND=bogus", "map atlas.nc -o new.png", "MPLBACKEND: Key backend: 'bogus' is not a valid value for backend; supported values are ..."),
]  # fmt: skip


@pytest.mark.usual("NUMBA_DISABLE_JIT=1-run small.toml -o new.nc", "NUMBA_NUM_THREADS=0", "MPLBACKEND=bogus")
@pytest.mark.parametrize(("setting", "command", "sentence"), ENVIRONMENTS)
def test_a_mistake_in_the_environment(setting, command, sentence, folder, monkeypatch):
    monkeypatch.chdir(folder)
    with unchanged_folder():
        process = subprocess.run(
            [sys.executable, "-m", "atlas", *command.split()], capture_output=True, text=True,
            env=os.environ | dict([setting.split("=")]),
        )  # fmt: skip
    assert (process.returncode, process.stdout) == (2, "")
    (line,) = process.stderr.splitlines()
    assert matches(line, f"atlas: {sentence}"), line


@pytest.mark.parametrize(("call", "sentence"), CALLS, ids=starts(CALLS))
def test_a_mistake_in_a_call(call, sentence, folder, datasets, monkeypatch):
    monkeypatch.chdir(folder)
    with unchanged_folder():
        assert_refused(lambda: call(*datasets), sentence)
