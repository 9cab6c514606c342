"""Co-simulation as in the paper's figure 7: damper units and vehicle exchange signals at a fixed step.

Eight instances of the damper's FMU (machine code, loaded by FMPy) stand in place of the vehicle's own
dampers; the vehicle stands for anybody's. Shown is what the communication step costs: the error of a damper's
force and of the bogie's acceleration, beside the same vehicle with its own dampers in one integration.

    pip install FMPy
    sayd export --fmu damper --set damper=sayd-estimate --out units
    python examples/cosimulation.py units/sayd_damper_fmi2.fmu
"""

from __future__ import annotations

import argparse
from typing import Any

import fmpy
import numpy as np

from sayd_env.config.scenario import load_scenario
from sayd_env.config.sensors import DAMPERS
from sayd_env.fmu.vehicle import VehicleUnit

SPEED = 300 / 3.6
STEPS = (5e-4, 1e-3, 2e-3, 4e-3)
FORCE, ACCELERATION = "force.front.left.upper", "lateral_acceleration.front.leading"


class Dampers:
    """Eight instances of a damper's unit (FMI 2.0); their ends are set after each step of the vehicle."""

    def __init__(self, path: str, command: float) -> None:
        folder = fmpy.extract(path)
        about = fmpy.read_model_description(folder)
        place = {variable.name: variable.valueReference for variable in about.modelVariables}
        self.inputs = [place[name] for name in ("x_1", "v_1", "x_2", "v_2", "current")]
        self.outputs = [place["F_1"], place["F_2"]]
        self.command = command
        self.units = [fmpy.instantiate_fmu(folder, about) for _ in DAMPERS]
        for unit in self.units:
            unit.setupExperiment(startTime=0.0)
            unit.setInteger([place["motion"]], [2])
            unit.setReal([place["current"]], [command])
            unit.enterInitializationMode()
            unit.exitInitializationMode()

    def step(self, time: float, h: float, ends: Any) -> Any:
        """Forces F_1 and F_2 (2, 8) after a step that the ends (4, 8) have arrived from."""
        forces = []
        for unit, end in zip(self.units, ends.T, strict=True):
            unit.setReal(self.inputs, [*end, self.command])
            unit.doStep(currentCommunicationPoint=time, communicationStepSize=h)
            forces.append(unit.getReal(self.outputs))
        return np.array(forces).T

    def close(self) -> None:
        """Terminate and free all instances."""
        for unit in self.units:
            unit.terminate()
            unit.freeInstance()


class Vehicle:
    """Our vehicle by names of its unit's variables."""

    def __init__(self, unit: VehicleUnit, *, outside: bool) -> None:
        self.unit = unit
        self.first = {v.name: i for i, v in enumerate(unit.variables)}
        self.value = np.array([v.start for v in unit.variables])
        self.value[self.first["speed"]], self.value[self.first["outside_dampers"]] = SPEED, outside
        unit.begin(self.value)

    def rows(self, *names: str) -> Any:
        """Variables of all dampers, (names, 8)."""
        begins = [self.first[f"{name}.{DAMPERS[0]}"] for name in names]
        return np.array([self.value[begin : begin + len(DAMPERS)] for begin in begins])


def alone(unit: VehicleUnit, h: float, seconds: float) -> Any:
    """Force and acceleration at each step (t, 2), the dampers in the vehicle's own integration."""
    vehicle, history = Vehicle(unit, outside=False), []
    for _ in range(round(seconds / h)):
        unit.step(h, vehicle.value)
        history.append([vehicle.value[vehicle.first[name]] for name in (FORCE, ACCELERATION)])
    return np.array(history)


def coupled(unit: VehicleUnit, path: str, h: float, seconds: float, ahead: float = 0.0) -> Any:
    """The same with dampers from outside: the vehicle steps first, under the forces that there were.

    Or under these and `ahead` of their last change: 0.5 for the middle of the step, 1 for its end.
    """
    vehicle, history = Vehicle(unit, outside=True), []
    dampers, before = Dampers(path, command=vehicle.rows("current")[0, 0]), np.zeros((2, len(DAMPERS)))
    for n in range(round(seconds / h)):
        unit.step(h, vehicle.value)
        forces = dampers.step(n * h, h, vehicle.rows("x_1", "v_1", "x_2", "v_2"))
        expected, before = forces + ahead * (forces - before), forces
        for name, row in zip(("F_1", "F_2"), expected, strict=True):
            begin = vehicle.first[f"{name}.{DAMPERS[0]}"]
            vehicle.value[begin : begin + len(DAMPERS)] = row
        history.append([forces[0, 0], vehicle.value[vehicle.first[ACCELERATION]]])
    dampers.close()
    return np.array(history)


def main() -> None:
    """Print the error over the communication step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("fmu", help="the damper's unit for FMI 2.0")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the run")
    options = parser.parse_args()
    unit = VehicleUnit(load_scenario("estimates", ['damper="sayd-estimate"']))
    print("           forces held       half a step ahead")
    print("step ms   force  accel. %     force  accel. %   (RMS of the difference over RMS)")
    for h in STEPS:
        one, errors = alone(unit, h, options.seconds), []
        for ahead in (0.0, 0.5):
            other = coupled(unit, options.fmu, h, options.seconds, ahead)
            errors += list(100.0 * np.sqrt(np.mean((other - one) ** 2, axis=0) / np.mean(one**2, axis=0)))
        print("{:7.1f}  {:6.1f}  {:8.1f}    {:6.1f}  {:8.1f}".format(1e3 * h, *errors))


if __name__ == "__main__":
    main()
