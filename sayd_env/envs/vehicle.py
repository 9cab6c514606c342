"""From a vehicle's model to what the control loop needs of it: signals' rows, limits, sensors, filters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.conditions import Line
from sayd_env.config.control import OnlineConfig
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.sensors import SIGNALS as SENSED
from sayd_env.config.sensors import SensorConfig, SensorsConfig
from sayd_env.config.units import Array
from sayd_env.envs import loop as places
from sayd_env.envs.loop import RAIL_FORCES, SIGNALS, Loop, LoopState
from sayd_env.envs.trace import BODY_ROWS, DAMPERS, POINTS
from sayd_env.physics import sayd
from sayd_env.physics.layout import Arrangement, displacement, longitudinal_rows
from sayd_env.physics.line import changes, line_table
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.track.realisation import TrackRealisation
from sayd_env.stability import Limits, limits
from sayd_env.stability.online import Band, BandState, band, band_state


@dataclass(frozen=True)
class LoopSettings:
    """Settings common to all vehicles of a batch.

    Raises
    ------
    ConfigError
        A control period that is not a whole number of samples, or of which a second has no whole number.
    """

    online: OnlineConfig
    control_period: float = 0.01
    """s."""
    sample_rate: float = 1000.0
    """Hz."""
    run_in: float = 500.0
    """Distance before step 0, m."""
    features: bool = False
    """Compute the features too."""
    quotient_limit: float = math.inf
    """Mean Y/Q beyond which a wheel is about to climb the rail."""
    averaging: float = 2.0
    """Distance over which Y/Q and track shift force are averaged, m."""
    tank_pressure: float = 1.0e5
    """What the pressure sensors of passive dampers read, Pa."""

    def __post_init__(self) -> None:
        period, second = self.control_period, self.sample_rate
        whole = math.isfinite(period) and period > 0.0 and abs(period * second - self.samples) < 1e-9
        if not whole or self.samples < 1 or round(second) % self.samples:
            raise ConfigError(
                f"control_period: found {period:g} s; expected a multiple of {1e3 / second:g} ms of which a "
                "second has a whole number, such as 0.001, 0.002, 0.005, 0.01, 0.02, 0.05 or 0.1 s"
            )

    @property
    def samples(self) -> int:
        """Samples in a control period."""
        return round(self.control_period * self.sample_rate)

    @property
    def per_second(self) -> int:
        """Samples in a second."""
        return round(self.sample_rate)


@dataclass(frozen=True)
class SensorErrors:
    """Errors of one vehicle's sensors, in addition to those of their configuration."""

    bias: Array
    """(SIGNALS,) added to the sensors' own, in the signals' units."""
    noise: Array
    """(SIGNALS,) factors of the sensors' noise."""


@dataclass(frozen=True)
class Vehicle:
    """One vehicle, ready to run."""

    track: TrackRealisation
    plant: Plant
    state: State
    work: Work
    loop: Loop
    memory: LoopState
    passed: BandState
    felt: BandState
    substeps: int
    run_in: int
    """Control periods before step 0."""
    current: float
    """Command during the run-in."""
    noise: np.random.Generator | None
    """Source of the sensors' noise; None if there is none."""
    speed: float
    """At step 0, m/s."""
    origin: float
    """Position on the track at step 0, m."""
    gauge: float
    """Of the track, m, where no line says another one."""
    friction: float
    """Coefficient of friction, likewise."""


def model_limits(model: VehicleModel) -> Limits:
    """Limits of EN 14363 for a vehicle, by its lightest wheelset and its heaviest bogie."""
    return limits(model.multibody.axle_load, model.multibody.bogie_mass)


def make_vehicle(
    model: VehicleModel,
    speed: float,
    track: TrackRealisation,
    sensors: SensorsConfig,
    settings: LoopSettings,
    *,
    band_constants: Band,
    current: float | None = None,
    errors: SensorErrors | None = None,
    noise: np.random.Generator | None = None,
    line: Line | None = None,
    distance: float = 0.0,
) -> Vehicle:
    """Put a vehicle with its sensors on a track.

    Parameters
    ----------
    model : VehicleModel
        A vehicle with two bogies, four measuring points and eight yaw dampers.
    speed : float
        m/s.
    track : TrackRealisation
    sensors : SensorsConfig
    settings : LoopSettings
    band_constants : Band
        Constants of the on-line filter at the sample rate.
    current : float, optional
        Valve command during the run-in; the damper's own by default.
    errors : SensorErrors, optional
    noise : Generator, optional
        Source of the sensors' noise; None for sensors without noise, and none of them will get any.
    line : Line, optional
        What changes along the way; `speed` is then that at its s = 0, where step 0 is.
    distance : float
        How far (m) the run goes beyond step 0, on a line.

    Raises
    ------
    ConfigError
        A vehicle of another structure, a speed outside its range, another sample rate; a line whose gauge the
        contact tables do not cover.
    """
    check_vehicle(model, settings)
    damper = model.scenario.damper
    semi_active = isinstance(damper, SaydDamperConfig)
    if current is None:
        current = damper.current if isinstance(damper, SaydDamperConfig) else 0.0
    run_in = run_in_periods(settings, speed)
    # The lowest speed decides the time step, and with it how long the valves' delay lines are.
    slowest = speed if line is None or line.slowest is None else line.slowest
    state = model.state(slowest)
    origin = run_in_distance(model, speed, settings)
    table = None
    if line is not None:
        _check_gauge(model, line)
    if line is not None and changes(line):
        table = line_table(line, origin, distance, speed, model.scenario.friction)
        model.check_speed(table.fastest)
    rails = line.rails if line is not None and line.reshaped else None
    if semi_active:
        for row in (sayd.CURRENT, sayd.COMMAND, sayd.COIL):
            state.sayd[row * LANES : (row + 1) * LANES] = current
        state.sayd_line[:] = current
    averaging = max(1.0, settings.averaging / speed * settings.sample_rate)
    longest = max(1.0, settings.averaging / slowest * settings.sample_rate)
    each = sensors_by_signal(sensors)
    bias, spread = np.array([s.bias for s in each]), np.array([s.noise for s in each])
    if errors is not None:
        bias, spread = bias + errors.bias, spread * errors.noise

    def filters() -> BandState:
        return band_state(
            band_constants,
            speed,
            channels=POINTS,
            groups=places.BOGIES,
            slowest=min(speed, slowest),
        )

    points = point_rows(model.multibody.arrangement, model.scenario.vehicle.floor_height)
    return Vehicle(
        track=track,
        plant=model.plant(slowest, track, points=points, line=table, rails=rails),
        state=state,
        work=model.work(len(points), line=table, rails=rails),
        loop=loop_constants(model, sensors, settings)._replace(noise=spread),
        memory=loop_state(settings, run_in, bias, averaging, longest),
        passed=filters(),
        felt=filters(),
        substeps=model.step(slowest)[1],
        run_in=run_in,
        current=current,
        noise=noise,
        speed=speed,
        origin=origin,
        gauge=model.scenario.track.gauge,
        friction=model.scenario.friction,
    )


def _check_gauge(model: VehicleModel, line: Line) -> None:
    """Refuse a line whose rails stand where the contact tables of the track's gauge do not reach."""
    if line.gauge is None:
        return
    own, reach = model.scenario.track.gauge, model.scenario.contact.table_half_width
    off = np.abs(np.array(line.gauge.value) - own)
    if off.max() > reach:
        worst = int(off.argmax())
        raise ConfigError(
            f"line: gauge: found {line.gauge.value[worst]:g} m at {line.gauge.s[worst]:g} m; the contact is "
            f"tabulated for {own:g} m, and a line may differ by {reach:g} m (contact.table_half_width); give "
            "the track such a gauge (track.gauge)"
        )


def run_in_periods(settings: LoopSettings, speed: float) -> int:
    """Control periods before step 0 at a speed (m/s)."""
    return math.ceil(settings.run_in / speed / settings.control_period - 1e-9)


def run_in_distance(model: VehicleModel, speed: float, settings: LoopSettings) -> float:
    """Position of a vehicle's centre on the track at step 0 (m), its first wheelset having begun at 0."""
    run = run_in_periods(settings, speed) * settings.control_period * speed
    return run - float(np.max(model.multibody.wheelset_x))


def check_vehicle(model: VehicleModel, settings: LoopSettings) -> None:
    """Refuse a vehicle that the control loop does not fit.

    Raises
    ------
    ConfigError
        See `make_vehicle`.
    """
    check_places(model, "the environment")
    if (rate := model.scenario.assessment.sample_rate) != settings.sample_rate:
        raise ConfigError(
            f"assessment.sample_rate: found {rate:g} Hz; the environment needs {settings.sample_rate:g} Hz"
        )


def check_places(model: VehicleModel, user: str) -> None:
    """Refuse a vehicle whose measuring points and yaw dampers are not those of two bogies.

    Raises
    ------
    ConfigError
        With their numbers, and `user`, who needs others.
    """
    body = model.multibody
    if len(body.measuring_points) != POINTS or len(body.yaw_dampers) != DAMPERS:
        raise ConfigError(
            f"{model.scenario.vehicle.name}: {len(body.measuring_points)} measuring points and "
            f"{len(body.yaw_dampers)} yaw dampers; {user} needs {POINTS} and {DAMPERS}"
        )


def on_line_band(model: VehicleModel, settings: LoopSettings) -> Band:
    """Constants of the on-line filter for vehicles of one assessment."""
    return band(settings.online, model.scenario.assessment, settings.sample_rate)


def loop_constants(model: VehicleModel, sensors: SensorsConfig, settings: LoopSettings) -> Loop:
    """Constants of a vehicle's sensors, cost and limits."""
    damper, cost = model.scenario.damper, model.scenario.cost
    dt = 1.0 / settings.sample_rate
    each = sensors_by_signal(sensors)
    return Loop(
        area=damper.cylinder.area if isinstance(damper, SaydDamperConfig) else 0.0,
        tank=damper.oil.tank_pressure if isinstance(damper, SaydDamperConfig) else settings.tank_pressure,
        per_acceleration=1.0 / model_limits(model).acceleration,
        per_force=1.0 / cost.force_reference,
        acceleration_weight=cost.acceleration_weight,
        force_weight=cost.force_weight,
        quotient_limit=settings.quotient_limit if math.isfinite(settings.quotient_limit) else 1e300,
        averaging=settings.averaging,
        features=float(settings.features),
        low=np.array([s.low for s in each]),
        high=np.array([s.high for s in each]),
        noise=np.zeros(SIGNALS),
        share=np.array([_share(s.bandwidth, dt) for s in each]),
        resolution=np.array([s.resolution for s in each]),
        hold=np.array([float(max(1, round(s.sampling / dt))) for s in each]),
    )


def _share(bandwidth: float | None, dt: float) -> float:
    """Share of a step that a first-order sensor covers in a sample (exact for a value held over it)."""
    return 1.0 if bandwidth is None else -math.expm1(-2.0 * math.pi * bandwidth * dt)


def sensors_by_signal(sensors: SensorsConfig) -> list[SensorConfig]:
    """The sensor of each signal."""
    return [sensors.of(signal) for signal in SENSED]


@lru_cache(maxsize=64)
def point_rows(design: Arrangement, floor_height: float | None) -> Array:
    """Rows that give the motion of the frames and of the carbody's floor, shape (4 + BODY_ROWS, n).

    Vehicles of one design share them.
    """
    return np.vstack([longitudinal_rows(design), body_rows(design, floor_height)])


def body_rows(design: Arrangement, floor_height: float | None) -> Array:
    """Rows that give the motion of the carbody's floor along x, y and z, shape (BODY_ROWS, n).

    Above the front bogie, mid-way and above the rear bogie; zeros where the vehicle does not say how high its
    floor is.
    """
    n, carbody = design.layout.n, design.instances.get("carbody")
    if floor_height is None or carbody is None:
        return np.zeros((BODY_ROWS, n))
    pivots = design.wheelset_x.reshape(places.BOGIES, -1).mean(axis=1)
    stations = (pivots[0], float(pivots.mean()), pivots[1])
    return np.vstack([displacement(carbody, np.array([x, 0.0, floor_height]), n) for x in stations])


def loop_state(
    settings: LoopSettings, run_in: int, bias: Array, averaging: float, longest: float
) -> LoopState:
    """Sensors and counters at the start of a run-in of so many control periods.

    `averaging` is the number of samples over which forces on the rails are averaged, `longest` that at the
    lowest speed.
    """
    return LoopState(
        counter=np.array([-run_in * settings.samples, 0]),
        filtered=np.zeros(SIGNALS),
        reading=np.zeros(SIGNALS),
        total=np.zeros(SIGNALS),
        gain=np.ones(SIGNALS),
        bias=bias.copy(),
        frozen=np.zeros(SIGNALS),
        squares=np.zeros((settings.per_second // settings.samples, POINTS + DAMPERS)),
        averaging=np.array([averaging]),
        rail=np.zeros(RAIL_FORCES),
        rail_mean=np.zeros(RAIL_FORCES),
        rail_sum=np.zeros(RAIL_FORCES),
        rail_ring=np.zeros((int(longest) + 1, RAIL_FORCES)),
        rail_place=np.zeros(1, dtype=np.int64),
        true=np.zeros(SIGNALS),
        passed=np.zeros(POINTS),
        felt=np.zeros(POINTS),
    )
