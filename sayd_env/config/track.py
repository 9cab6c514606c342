"""Track: co-moving sections, gauge and irregularities.

Channels and signs (SI inside the program): `alignment` is the lateral position of the centre line, positive
to the left (m); `vertical` its height, positive up (m); `cross_level` the angle of the track plane about the
direction of travel, positive when the left rail is higher (rad); `gauge` the widening of the gauge (m).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StrictFloat, model_validator

from sayd_env.config.base import Model, Number, Part, quantity
from sayd_env.config.distribution import Distribution
from sayd_env.config.errors import ConfigError
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.limits import within
from sayd_env.config.loader import is_path

TRACK = Kind(
    "track",
    parts={"section": Kind("section")},
    data=("irregularity.path",),
    measured="track",
)

Channel = Literal["alignment", "vertical", "cross_level", "gauge"]
CHANNELS: tuple[Channel, ...] = ("alignment", "vertical", "cross_level", "gauge")
HIGHEST = 0.1
"""Largest amplitude of a sine or a defect (m, rad): whole numbers of millimetres lie above."""
SHORTEST_DEFECT = 2.0
"""Shortest single defect (m): eight points of the grid on which tracks are made."""
SOFTEST = 1e5
"""Least stiffness of a track to the ground (N/m): numbers in MN/m and kN/mm lie below."""


class SectionConfig(Part):
    """The piece of track that moves along under each wheelset: a body that shifts, sinks and rolls."""

    mass: float = quantity("kg", "mass of the section", gt=0)
    roll_inertia: float = quantity("kg m2", "moment of inertia about the direction of travel", gt=0)
    lateral_stiffness: float = quantity(
        "N/m", "lateral stiffness to the ground, both rails together", ge=SOFTEST
    )
    lateral_damping: float = quantity("N s/m", "lateral damping to the ground, both rails together", ge=0)
    vertical_stiffness: float = quantity(
        "N/m", "vertical stiffness to the ground under each rail", ge=SOFTEST
    )
    vertical_damping: float = quantity("N s/m", "vertical damping to the ground under each rail", ge=0)
    seat_half_spacing: float = quantity(
        "m", "distance of each vertical support from the centre line", ge=0.1, le=3.0
    )


class _Irregularity(Model):
    scale: float = quantity("-", "factor on the amplitude of every channel", default=1.0, ge=0)


class LevelsConfig(Model):
    """Amplitude factors of the channels of a spectrum."""

    alignment: float = quantity("-", "factor on the amplitude of the alignment", default=1.0, ge=0)
    vertical: float = quantity("-", "factor on the amplitude of the vertical irregularity", default=1.0, ge=0)
    cross_level: float = quantity("-", "factor on the amplitude of the cross-level", default=1.0, ge=0)
    gauge: float = quantity("-", "factor on the amplitude of the gauge irregularity", default=1.0, ge=0)


class GermanDensityConfig(Model):
    r"""Densities of ERRI B176, one-sided over the angular wavenumber :math:`\Omega`.

    Alignment and vertical :math:`A\Omega_c^2 / ((\Omega^2+\Omega_r^2)(\Omega^2+\Omega_c^2))`; gauge the same
    times :math:`\Omega^2/(\Omega^2+\Omega_s^2)`; cross-level (an angle) as gauge with :math:`A_v/b^2` for A.
    """

    type: Literal["german"]
    alignment: float = quantity("m2 rad/m", "A_a of the alignment", ge=0)
    vertical: float = quantity("m2 rad/m", "A_v of the vertical irregularity and of the cross-level", ge=0)
    gauge: float = quantity("m2 rad/m", "A_g of the gauge irregularity", ge=0)
    omega_c: float = quantity("rad/m", "upper cut-off Omega_c", gt=0)
    omega_r: float = quantity("rad/m", "lower cut-off Omega_r", gt=0)
    omega_s: float = quantity("rad/m", "cut-off Omega_s of cross-level and gauge", gt=0)
    half_base: float = quantity("m", "b, half the distance of the rolling circles", gt=0)


class PowerLawConfig(Model):
    """A density of joined power laws, one-sided: S(f) = A / f^k, each pair (A, k) between two limits of f."""

    limits: tuple[Annotated[StrictFloat, Field(gt=0)], ...] = Field(
        description="ascending spatial frequencies at which the law changes (1/m)"
    )
    coefficients: tuple[Annotated[StrictFloat, Field(gt=0)], ...] = Field(
        description="A of each law (S in mm2/(1/m) with f in 1/m)"
    )
    exponents: tuple[Annotated[StrictFloat, Field(ge=0)], ...] = Field(description="k of each law (-)")

    @model_validator(mode="after")
    def _laws_fit_the_limits(self) -> PowerLawConfig:
        laws = len(self.limits) + 1
        if len(self.coefficients) != laws or len(self.exponents) != laws:
            raise ValueError(
                f"{len(self.limits)} limits need {laws} coefficients and {laws} exponents, "
                f"found {len(self.coefficients)} and {len(self.exponents)}"
            )
        if any(a >= b for a, b in pairwise(self.limits)):
            raise ValueError("limits must ascend")
        return self


class ChinaDensityConfig(Model):
    """Chinese high-speed (ballastless) spectrum: a mean spectrum of power laws, or a percentile of it."""

    type: Literal["china"]
    percentile: float | None = quantity(
        "-", "percentile p of the spectrum, mean x -ln(1-p); the mean when absent", default=None, gt=0, lt=1
    )
    cross_level_base: float = quantity("m", "distance over which the cross-level's height is measured", gt=0)
    alignment: PowerLawConfig
    vertical: PowerLawConfig
    cross_level: PowerLawConfig = Field(description="of the difference in height of the rails")
    gauge: PowerLawConfig


class BrokenLawConfig(Model):
    """Roughness and cut-offs of one channel of an American spectrum."""

    roughness: float = quantity("m2 times the unit of the wavenumber", "A", gt=0)
    lower: float = quantity("unit of the wavenumber", "lower cut-off l", ge=0)
    upper: float = quantity("unit of the wavenumber", "upper cut-off u", gt=0)


class AmericanDensityConfig(Model):
    r"""Densities of American track, one-sided over a wavenumber :math:`\kappa` in cycles/m or rad/m.

    Alignment and vertical :math:`A u^2 (\kappa^2+l^2) / (\kappa^4 (\kappa^2+u^2))`, cross-level (a height)
    and gauge :math:`A u^2 / ((\kappa^2+l^2)(\kappa^2+u^2))`: Hamid, Rasmussen, Baluja and Yang (1983). The
    form of Garg and Dukkipati (1984), :math:`k A_v \Omega_c^2 / (\Omega^2 (\Omega^2+\Omega_c^2))` and
    :math:`4 k A_v \Omega_c^2 / ((\Omega^2+\Omega_c^2)(\Omega^2+\Omega_s^2))`, is that of l = 0 and of
    :math:`l = \Omega_s`.
    """

    type: Literal["american"]
    wavenumber: Literal["cycles/m", "rad/m"] = Field(description="unit of the wavenumber")
    cross_level_base: float = quantity("m", "distance over which the cross-level's height is measured", gt=0)
    alignment: BrokenLawConfig
    vertical: BrokenLawConfig
    cross_level: BrokenLawConfig = Field(description="of the difference in height of the rails")
    gauge: BrokenLawConfig

    @model_validator(mode="after")
    def _cut_off_below(self) -> Self:
        for name in ("cross_level", "gauge"):
            if getattr(self, name).lower == 0.0:
                raise ValueError(f"{name}.lower must be positive: its variance has no end without")
        return self


class SpectrumConfig(_Irregularity):
    """Random irregularities of given power spectral densities, within a band of wavelengths."""

    type: Literal["spectrum"]
    wavelength_min: float = quantity("m", "shortest wavelength", gt=0)
    wavelength_max: float = quantity("m", "longest wavelength", gt=0, le=1000)
    levels: LevelsConfig = LevelsConfig()
    density: Annotated[
        GermanDensityConfig | ChinaDensityConfig | AmericanDensityConfig, Field(discriminator="type")
    ]

    @model_validator(mode="after")
    def _band_is_not_empty(self) -> SpectrumConfig:
        if self.wavelength_min >= self.wavelength_max:
            raise ValueError(
                f"wavelength_min ({self.wavelength_min} m) must be below "
                f"wavelength_max ({self.wavelength_max} m)"
            )
        return self


class SineConfig(_Irregularity):
    """A sine along the track that starts with zero at position 0."""

    type: Literal["sine"]
    channel: Channel = Field(description="channel that carries the sine")
    amplitude: float = quantity("m, or rad for cross_level", "amplitude", ge=-HIGHEST, le=HIGHEST)
    wavelength: float = quantity("m", "wavelength", gt=0)


class Defect(Model):
    """A single defect: amplitude (1 - cos(2 pi (x - position) / length)) / 2."""

    channel: Channel = Field(description="channel that carries the defect")
    amplitude: float = quantity("m, or rad for cross_level", "height of the defect", ge=-HIGHEST, le=HIGHEST)
    length: float = quantity("m", "length of the defect", ge=SHORTEST_DEFECT)
    position: float = quantity("m", "where the defect begins", ge=0)


class DefectConfig(Defect, _Irregularity):
    """A track that is even but for a single defect."""

    type: Literal["defect"]


Domain = Literal["D1", "D2", "D3"]
DOMAINS: Mapping[Domain, tuple[float, float]] = MappingProxyType(
    {"D1": (3.0, 25.0), "D2": (25.0, 70.0), "D3": (70.0, 200.0)}
)
"""Wavelengths of the domains of EN 13848-1 (m); D3 of the longitudinal level ends at 150 m."""


class GeometryConfig(Model):
    """What a file of measured irregularities does not say itself."""

    cross_level_base: float = quantity(
        "m", "distance over which the cross-level's height is measured", default=1.5, ge=0.3, le=2.5
    )
    nominal_gauge: float | None = quantity(
        "m", "what is taken off a column that holds the gauge itself", default=None, ge=0.5, le=2.0
    )
    domains: tuple[Domain, ...] = Field(
        (), description="Wavelength domains of EN 13848-1 whose columns are added: D1, D2, D3"
    )
    recover: tuple[Number, Number] | None = Field(
        None, description="Shortest and longest wave (m) that is restored from a chord or a space curve"
    )
    ignore: tuple[str, ...] = Field((), description="Columns that are not read, as the header names them")

    @model_validator(mode="after")
    def _geometry_is_possible(self) -> Self:
        if self.recover is not None and not 0.0 < self.recover[0] < self.recover[1] <= 1000.0:
            raise ValueError("recover: needs 0 < shortest < longest, at most 1000 m")
        if tuple(sorted(set(self.domains))) != self.domains:
            raise ValueError("domains: each once, in order: D1, D2, D3")
        spans = [DOMAINS[domain] for domain in self.domains]
        if any(one[1] != other[0] for one, other in pairwise(spans)):
            raise ValueError("domains: D2 is missing between D1 and D3")
        return self

    @property
    def geometry(self) -> dict[str, Any]:
        """These keys and values."""
        return {name: getattr(self, name) for name in GeometryConfig.model_fields}


class FileConfig(_Irregularity, GeometryConfig):
    """Measured irregularities: x_m and any of alignment_mm, vertical_mm, cross_level_mm, gauge_mm."""

    type: Literal["file"]
    path: str = Field(min_length=1, description="CSV file; relative to the YAML file that names it")
    offset: float = quantity("m", "position on the run of the file's x = 0", default=0.0, ge=-1e7, le=1e7)
    ramp: float | None = quantity(
        "m",
        "length of smooth ramps at the file's ends, the track being even outside, though not where a run is "
        "judged; when absent the file must cover the whole run",
        default=None,
        gt=0,
        le=1e6,
    )


class NoIrregularityConfig(Model):
    """An even track."""

    type: Literal["none"]


IrregularityConfig = SpectrumConfig | SineConfig | DefectConfig | FileConfig | NoIrregularityConfig


class TrackConfig(Part):
    """A track: sections under the wheelsets, gauge, irregularities."""

    section: SectionConfig
    gauge: float = quantity("m", "nominal gauge, at the rail profile's gauge depth", gt=0.5, lt=2)
    irregularity: Annotated[IrregularityConfig, Field(discriminator="type")]


def read_track(name_or_path: str, overrides: Iterable[str] = ()) -> TrackConfig:
    """Read and validate a track.

    Parameters
    ----------
    name_or_path : str
        Packaged name (``german_low``) or path to a YAML file. A measured file that this file names is taken
        relative to it.
    overrides : iterable of str
        ``key=value`` assignments, for example ``irregularity.scale=0.5``.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, unknown key, or value out of its range.
    """
    return read_layered(TrackConfig, TRACK, name_or_path, overrides)


def read_irregularity(name_or_path: str) -> IrregularityConfig:
    """Read the irregularities of a track, a packaged one once only; see `read_track`."""
    # A packaged track stays as it is, a user's file may be edited between episodes.
    return _packaged(name_or_path) if not is_path(name_or_path) else read_track(name_or_path).irregularity


@lru_cache(maxsize=64)
def _packaged(name: str) -> IrregularityConfig:
    return read_track(name).irregularity


def scalable(irregularity: IrregularityConfig, name: str) -> None:
    """Check that irregularities have an amplitude.

    Raises
    ------
    ValueError
        An even track.
    """
    if isinstance(irregularity, NoIrregularityConfig):
        raise ValueError(f"track '{name}' is even: it has nothing to scale")


def check_track(name: str, *, scaled: bool) -> None:
    """Check that a track can be read and, if it is to be scaled, has irregularities.

    Raises
    ------
    ValueError
        It cannot, or has none.
    """
    try:
        irregularity = read_irregularity(name)
    except ConfigError as error:
        raise ValueError(str(error)) from None
    if scaled:
        scalable(irregularity, name)


class TrackClass(Model):
    """A track whose irregularities an episode may have; section and gauge stay those of the scenario."""

    name: str = Field(min_length=1, description="Name of a track, or a path to its YAML file")
    weight: float = quantity("-", "Relative frequency", default=1.0, ge=0.0, le=1e9)
    scale: Distribution | None = Field(
        None, description="Factor on all amplitudes (-), in place of the track's own; null: its own"
    )

    @model_validator(mode="after")
    def _known(self) -> TrackClass:
        check_track(self.name, scaled=self.scale is not None)
        if self.scale is not None:
            within(self.scale, "track_scale")
        return self
