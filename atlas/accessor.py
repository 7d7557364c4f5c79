"""The accessor `ds.atlas` for questions to an atlas. The module `registration` registers the accessor with xarray.

An atlas may be larger than memory. Therefore every dataset, whether lazy, chunked or in memory, is read in chunks. Only the
methods that make figures, films and pages import Matplotlib.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .errors import BadInput, text_table
from .extension import load, parts
from .faces import Questions
from .plotting.options import takes_map_options
from .scene.checks import typed

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .plotting.options import Width
    from .plotting.trajectory import Film


@typed
class Atlas(Questions):
    """Questions to a dataset made by `atlas.run`, `atlas.open_atlas`, `atlas.label_points` or `atlas.trajectory`.

    Every method raises BadInput for an unknown name or value, and for a dataset that cannot answer the question. Such a dataset
    may lack axes, flags or variables, may have more than two axes to draw, or may belong to a family without a motion. Its
    coordinates may also differ from the values in the scene, from which motions and theory are computed.
    """

    def __init__(self, ds: xr.Dataset) -> None:
        from .store.joined import subject_of

        self._ds = subject_of(ds)

    def __repr__(self) -> str:
        """Return one line for each method, with its name and the first line of its docstring."""
        rows = [(f"ds.atlas.{name}()", each.__doc__.partition("\n")[0]) for name, each in questions().items()]
        return text_table(rows)

    @takes_map_options
    def map(self, variable: str | None = None, **options: Any) -> Figure:
        """Figure of one variable over two axes, or of single points over two of their parameters.

        A flag has the same colour in every figure. Positive numbers that span more than two decades have a logarithmic colour
        scale, unless they are angles. Numbers of both signs have a scale centred on zero, and integers have one colour for each
        value. Cells without a value are white. Over a single axis the figure is a curve, with a level for each flag.

        Parameters
        ----------
        variable : str, optional
            The default is `map` in [outputs] of the scene, else label, else the first flag variable that is not constant.
        **options

        Returns
        -------
        matplotlib.figure.Figure
            With one panel, or one for each value of `row` and `col`; the figure of `ax` if `ax` is given.
        """
        from .plotting.maps import atlas_map

        return atlas_map(self._ds, variable, **options)

    def select(self, *, degrees: bool = False, **flags: str | int | Sequence[str | int]) -> xr.Dataset:
        """The points that have the given flags.

        Parameters
        ----------
        degrees : bool, optional
            Return angles in degrees, for tables. Methods that compute anything refuse such a dataset.
        **flags : str, int or sequence of str or int
            Flag variable -> one or several names or numbers, such as label="drifting", label=3,
            agreement=["theory_only", "differ"]. A point is selected if it matches for every variable.

        Returns
        -------
        Dataset
            The points in memory along the dimension "point", in the order of the atlas; its axes and
            parameters are coordinates along "point".
        """
        from .analysis.select import select

        return select(self._ds, flags, degrees)

    def nearest(self, *, degrees: bool = False, **coords: float) -> xr.Dataset:
        """The point nearest to values of some axes (or, among single points, of any parameters).

        Parameters
        ----------
        degrees : bool, optional
            Take and return angles in degrees.
        **coords : float
            Axis or parameter -> value. Along an axis, the nearest point is the one whose cell of the map contains the value. Among
            single points each distance is divided by the range of the parameter over the points.

        Returns
        -------
        Dataset
            The point, with all values of the axes that are not in `coords`.
        """
        from .analysis.degrees import in_degrees
        from .analysis.select import nearest

        return in_degrees(nearest(self._ds, coords, degrees), degrees)

    def to_dataframe(self, *, degrees: bool = False) -> pd.DataFrame:
        """A pandas table with a row for each point, in memory.

        Parameters
        ----------
        degrees : bool, optional
            Angles in degrees.

        Returns
        -------
        pandas.DataFrame
            Indexed by the axes, or by "point" for single points. The columns are variables and parameters; flags are
            categories with their names.
        """
        from .analysis.select import to_dataframe

        return to_dataframe(self._ds, degrees)

    def fractions(self, variable: str = "label", along: str | None = None) -> xr.DataArray:
        """Fraction of the points with each flag of a variable, among all points or along one axis.

        Parameters
        ----------
        variable : str, optional
            A flag variable; default label.
        along : str, optional
            An axis of the atlas.

        Returns
        -------
        DataArray
            float64. Dimensions: `along` if it is given, then a dimension named like the variable, whose coordinate is the names of
            the flags. The fractions of all flags sum to 1; they are nan where there are no points.
        """
        from .analysis.trust import fractions

        return fractions(self._ds, variable, along)

    def probability(self, variable: str = "label", *, over: str | Sequence[str]) -> xr.Dataset:
        """Probability of each flag of a variable, over an axis of random draws.

        Parameters
        ----------
        variable : str, optional
            A flag variable; default label.
        over : str or sequence of str
            The axis, or axes, of the random draws.

        Returns
        -------
        Dataset
            `probability`, and the limits `lower` and `upper` of Wilson's 95 % interval for each cell. The dimensions are the
            other axes, and a dimension with the name of the variable and the names of flags as coordinate. For example,
            `.sel(label="drifting").atlas.map()` maps the probability of drifting. A draw without a motion counts as not_computed.
        """
        from .analysis.trust import probability

        return probability(self._ds, variable, over)

    def boundary(
        self,
        label: str | int | None = None,
        variable: str = "label",
        *,
        x: str | None = None,
        y: str | None = None,
        select: Mapping[str, float] | None = None,
        degrees: bool = False,
    ) -> xr.Dataset:
        """Lines on the plane of two axes: the borders that theory predicts, or the border of a measured region.

        Parameters
        ----------
        label : str or int, optional
            Name or number of a flag: the lines enclose the region where the variable has this flag. Default: the lines of
            theory.
        variable : str, optional
            A flag variable or, for lines of theory, any variable; default label. Lines of theory hold in the frame of the
            variable, such as inertial space for label_inertial. If the variable is a frequency or stability_kind, lines of
            resonances are added. If an extension has lines for the variable, only the lines of the extension are returned.
        x, y : str, optional
            Axes, as in `map`.
        select : mapping of str to float, optional
            Axis -> value, for the other axes.
        degrees : bool, optional
            Take and return angles in degrees.

        Returns
        -------
        Dataset
            The dimension "vertex" lists the vertices line by line. The variables are the values of the axes, the number `line`
            of the line, and `kind`, which says what changes at the line, such as "stability limit". Lines of theory have the kinds
            `atlas.analysis.boundary.KINDS` and, for exact motions of a family, kinds such as "conical (exact)". A line is closed
            or ends at a limit of the axes. Attributes are the parameters that all points share, with angles in rad. Lines of a
            region run halfway between points inside and outside, and on a logarithmic axis halfway between the logarithms. If an axis
            has more than `atlas.analysis.select.MAX_CELLS` values, only every second (third, ...) value is used.
        """
        from .analysis.boundary import boundary

        return boundary(self._ds, label, variable, x, y, select or {}, degrees)

    def trajectory(self, *, samples: int = 1001, degrees: bool = False, **coords: float) -> xr.Dataset:
        """Motion of the point nearest to values of the axes, integrated again as the atlas was.

        Start, nudge, duration, method and step come from the scene of the atlas, or from the point if there is no scene.

        Parameters
        ----------
        samples : int, optional
            Number of evenly spaced instants from 0 to the duration, at least 2.
        degrees : bool, optional
            Take and return angles in degrees.
        **coords : float
            As in `nearest`; an atlas with a scene needs a value for every axis.

        Returns
        -------
        Dataset
            The variables lie along "time"; see `atlas.trajectory`.
        """
        from .analysis.degrees import in_degrees
        from .analysis.select import nearest_trajectory

        return in_degrees(nearest_trajectory(self._ds, coords, samples, degrees), degrees)

    def compare(self, other: xr.Dataset | None = None, worst: int = 5, *, degrees: bool | None = None) -> str:
        """Comparison with theory, or with another atlas on the same grid, in plain text, as `atlas compare` prints it.

        Parameters
        ----------
        other : Dataset, optional
            An atlas with the system and the grid of this one, such as one with another tolerance or damping.
        worst : int, optional
            Number of disagreements, or of changes of each label, to list, at least 0.
        degrees : bool, optional
            Print the angles of points in degrees. By default only angles of axes with display_units = "deg" are in degrees.

        Returns
        -------
        str
            A comparison with theory has a confusion table, the agreement, linearly unstable points with a steady label, and the
            clearest disagreements. A comparison with another atlas has the differences of the scenes and the changes of flags, with a
            table of labels in this atlas (rows) and in the other (columns). For each numeric variable the text has the largest
            difference, and the place and size of the largest ratio of the difference to the larger error_estimate of the two
            atlases. Variables are loaded whole, one after another.
        """
        if other is None:
            from .analysis.compare import report

            return report(self._ds, worst, degrees)
        from .analysis import differences

        return differences.report(self._ds, other, worst, degrees)

    def differences(self, other: xr.Dataset) -> xr.Dataset:
        """Changes of flags and numbers from this atlas to another one on the same grid. Maps can show the changes.

        Parameters
        ----------
        other : Dataset
            As for `compare`.

        Returns
        -------
        Dataset
            Flags give variables such as `label_change`, with flags such as unchanged and to_drifting. Numbers give variables such
            as `theta_max_difference`, the other atlas minus this one. `differences(other).atlas.map()` draws where labels change.
        """
        from .analysis import differences

        return differences.differences(self._ds, other)

    def families(
        self, *, x: str | None = None, y: str | None = None, select: Mapping[str, float] | None = None
    ) -> dict[str, list[np.ndarray]]:
        """Curves of exact steady motions on the plane of one or two axes, from theory.

        Parameters
        ----------
        x, y : str, optional
            Axes, as in `map`.
        select : mapping of str to float, optional
            Axis -> value, for the other axes.

        Returns
        -------
        dict
            Family -> curves of shape (vertices, axes), x first; `atlas.analysis.exact_curves.family_curves` says which families
            have curves.
        """
        from .analysis.exact_curves import family_curves
        from .analysis.metadata import resolved_scene, scene_of, system_of
        from .analysis.plane import Plane
        from .analysis.select import plane_of
        from .variables import POINT

        system_of(self._ds)
        if (scene := scene_of(self._ds, needed=True)) is None:
            raise BadInput("families: these points come from no scene, so that there are no axes")
        if self._ds.sizes.keys() == {POINT}:
            raise BadInput("families: these are single points without axes")
        plane, dims, panel_dims = plane_of(self._ds, x, y, select or {})
        for dim in panel_dims:
            raise BadInput(f"{dim} has {plane.sizes[dim]} values here: choose one by select")
        resolved_scene(self._ds, plane)
        return family_curves(Plane.of(scene, plane, dims))

    def plot(
        self,
        ax: Axes | None = None,
        *,
        view: tuple[float, float] = (40.0, 25.0),
        degrees: bool = False,
        width: Width = "page",
    ) -> Figure:
        """Figure of a motion from `atlas.trajectory`: angles, rates, and the path of the third axis on the sphere.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes for the sphere alone; default a figure with all panels, as `atlas trajectory` draws it.
        view : (float, float)
            Azimuth and elevation of the viewer in degrees. The azimuth is measured from the first axis of the frame towards the
            second. About a fixed point the third axis of the frame points down, and the azimuth is measured from x towards -y.
        degrees : bool
            Show angles in degrees.
        width : {"page", "column"} or float
            "page" is 180 mm, "column" is 88 mm, and a number is in mm. Below 140 mm the sphere is under the other panels.

        Returns
        -------
        matplotlib.figure.Figure
            The path is dark on the near side of the sphere and pale on the far side. A dot marks the start, and up is at the
            top. For a system with observables, the figure shows the observables over time.
        """
        from .plotting.trajectory import trajectory_figure

        return trajectory_figure(self._ds, ax=ax, view=view, degrees=degrees, width=width)

    def animate(
        self,
        path: str | Path | None = None,
        *,
        seconds: float = 10.0,
        view: tuple[float, float] = (40.0, 25.0),
    ) -> Film | None:
        """Animation of a motion from `atlas.trajectory`: the third axis on the sphere, with its trace.

        Parameters
        ----------
        path : str or Path, optional
            File to write or replace: .gif, or .mp4 by the program ffmpeg.
        seconds : float, optional
            Length of the animation; it has at most 25 frames per second, and at most one frame for each sample of the motion.
        view : (float, float)
            As in `plot`.

        Returns
        -------
        matplotlib.animation.FuncAnimation or None
            The animation, which a notebook shows with buttons; None if `path` is given.
        """
        from .plotting.trajectory import animate

        return animate(self._ds, path, seconds, view)

    def roughness(self, x: str | None = None, y: str | None = None) -> xr.DataArray:
        """How roughly the range of theta varies over the grid: a picture of chaos without its cost, not a label.

        Parameters
        ----------
        x, y : str, optional
            Axes along which differences are taken; default: all.

        Returns
        -------
        DataArray
            Sum over the axes of the magnitudes of second differences of theta_max - theta_min, rad; nan at the edges. Unlike a
            Lyapunov exponent, the sum needs no further integration. The sum is small where motions depend smoothly on the
            parameters, and large at borders and where motions are chaotic. Draw the logarithm of the sum.

        References
        ----------
        J. Daquin and C. Charalambous (2022): the second derivative of the diameter of orbits.
        """
        from .analysis.trust import roughness

        return roughness(self._ds, x, y)

    def trust(self, variable: str = "label") -> xr.Dataset:
        """Reliability of a map between its points, estimated from the map itself.

        A cell of side s has corners that are s points apart. Only axes with at least `atlas.analysis.trust.MIN_VALUES` values are
        divided into cells; each value of a shorter axis is a separate map.

        Parameters
        ----------
        variable : str, optional
            A flag variable; default label.

        Returns
        -------
        Dataset
            - uncertain (stride): fraction of the cells of side 1, 2, 4, ... whose corners differ. The fraction for side 1 is the
              part of the map in which a border runs.
            - exponent: least-squares slope of log(uncertain) over log(side) [1]_, or nan if fewer than two values of `uncertain`
              are above 0. The slope is 1 for smooth borders and near 0 for fractal borders, which finer grids hardly sharpen. The
              dimension of the borders is the number of axes minus the exponent.
            - entropy: mean of -sum p ln p over boxes of `atlas.analysis.trust.BOX` points along each axis, where p are the
              fractions of the flags in a box [3]_.
            - border_entropy: the same mean over boxes with several flags. A value above ln 2 means fractal borders.
            - missed: of the cells of side 2 whose corners are equal, the fraction that has another value at a point between corners,
              such as an island or a thin tongue.
            - missed_bound: upper 95 % bound of missed [2]_, if cells are independent samples. The bound holds for cells of side
              2. The cells of the map have side 1 and miss less if the exponent is above 0.

        References
        ----------
        .. [1] Grebogi, McDonald, Ott & Yorke, Phys. Lett. A 99 (1983) 415.
        .. [2] Clopper & Pearson, Biometrika 26 (1934) 404.
        .. [3] Daza, Wagemakers, Georgeot, Guery-Odelin & Sanjuan, Sci. Rep. 6 (2016) 31416.
        """
        from .analysis.trust import trust

        return trust(self._ds, variable)

    def cite(self, *, bibtex: bool = False) -> str:
        """Text that names the program, the equations and the computation behind a result from this atlas.

        Parameters
        ----------
        bibtex : bool, optional
            Return BibTeX instead: entries for the program, for the paper of the system, and for this atlas.

        Returns
        -------
        str
            Three lines, or three entries. The entry of the atlas has the hash of the result or, for single points, of the kernel.
        """
        from .analysis.citation import cite

        return cite(self._ds, bibtex)


def questions() -> dict[str, Any]:
    """Return the methods of `ds.atlas` by name, first those of the core, then those of extensions."""
    own = {name: method for name, method in vars(Atlas).items() if not name.startswith("_")}
    return own | {name: load("questions", name) for name in parts("questions")}
