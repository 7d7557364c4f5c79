"""The label: flags of its own, and the rule by which they follow from the mean of psi'."""

import numpy as np

from atlas.measure.instrument import Instrument, Rule, Variable

FLAGS = {
    "none": "no precession, or no label: see status",
    "retrograde": "the mean of psi' is negative",
    "prograde": "the mean of psi' is positive",
}


class Sense(Instrument):
    """Makes `precession_sense` of bodies in a frame, for scenes that ask for it."""

    needs_whole_run = True  # of a part of it the mean may have another sign

    def variables(self, system):
        text = f"sense of the precession about the vertical of the {system.frame} frame"
        variable = Variable("precession_sense", "int8", "1", text, FLAGS, optional=True)
        return () if system.observables else (variable,)

    def rules(self, run, rules):
        def sense(measured):
            return np.select([measured["psi_dot_mean"] < 0, measured["psi_dot_mean"] > 0], [1, 2], 0)

        return {"precession_sense": Rule(sense, ("psi_dot_mean",), drifting="none", unresolved="none")}


SENSE = Sense()
