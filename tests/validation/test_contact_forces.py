"""Creep forces against CONTACT: FASTSIM and its table against its FASTSIM, laws against its half-space.

Source of the tables: CONTACT by E. A. H. Vollebregt (open source, revision 2707); conditions in the heads of
the files in data/. The half-space tables are about 2 % too stiff in the linear range (41 x 41 elements); the
extrapolated table is the most exact one.

Errors are vectors over mu N. Polach's law, measured over all 488 rows of each table, per spin (1/m), max:

    spin      0      0.1     0.2     0.5     1.0     mean of all rows
    a/b 0.5   8.6 %  9.9 %   12.0 %  16.7 %  19.5 %  5.4 %
    a/b 1.0   6.3 %  8.9 %   12.1 %  17.6 %  22.3 %  6.5 %

A wheel tread has a spin up to about 0.1 1/m, a flange contact about 1 1/m; a worn tread has up to 0.5 1/m and
a/b of 1.7 to 4, where the time loop's table of FASTSIM is compared with FASTSIM: along runs of the packaged
vehicle, and at single ratios.

FASTSIM's elliptic bound in place of the parabolic one lies 2.3 and 2.2 % of mu N from the half-space in the
mean, not 1.5 and 1.1 % (a/b 0.5 and 1); along runs its forces differ from the parabolic one's by 1.2 % of
mu N in the mean on new and by 2.1 % on worn wheels, and by 11 % at most.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import Array
from sayd_env.physics.contact import creep
from sayd_env.physics.contact.fastsim import fastsim
from sayd_env.physics.contact.kalker import kalker_coefficients
from sayd_env.physics.contact.polach import polach_forces
from sayd_env.physics.simulator import Simulator, VehicleModel

DATA = Path(__file__).parent / "data"
NORMAL, SHEAR_MODULUS, POISSON, MEAN_AXIS = 75e3, 82e9, 0.28, 5.5e-3
RATIOS = ["0.5", "1.0"]


class Contact(NamedTuple):
    """Ellipse and Kalker coefficients of a table."""

    a: float
    b: float
    coefficients: tuple[float, float, float]


def contact(ratio: float) -> Contact:
    c11, c22, c23 = (float(c) for c in kalker_coefficients(ratio, POISSON))
    return Contact(MEAN_AXIS * math.sqrt(ratio), MEAN_AXIS / math.sqrt(ratio), (c11, c22, c23))


def table(name: str) -> NDArray[np.void]:
    lines = [line for line in (DATA / name).read_text().splitlines() if not line.startswith("#")]
    return np.genfromtxt(lines, delimiter=",", names=True)


def polach_on(rows: NDArray[np.void], ratio: float, friction: Array) -> Array:
    c = contact(ratio)
    return np.array(
        polach_forces(
            rows["xi"], rows["eta"], rows["spin"], NORMAL, c.a, c.b, c.coefficients, friction, SHEAR_MODULUS
        )
    )


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("bound", ["ell", "par"])
def test_fastsim_against_contact(ratio: str, bound: str) -> None:
    """Forces within 1 % of mu N (measured 0.9 %) and moments within 1 % of mu N a, by CONTACT's own march."""
    rows = table(f"creep_forces_aob{ratio}.csv")
    c = contact(float(ratio))
    found = np.array(
        [
            fastsim(
                row["xi"],
                row["eta"],
                row["spin"],
                NORMAL,
                c.a,
                c.b,
                *c.coefficients,
                row["mu"],
                SHEAR_MODULUS,
                41,
                41,
                bound == "par",
                True,
            )
            for row in rows
        ]
    ).T
    limit = rows["mu"] * NORMAL
    error = np.hypot(found[0] - rows[f"{bound}_fx"], found[1] - rows[f"{bound}_fy"]) / limit
    moment_error = np.abs(found[2] - 1e-3 * rows[f"{bound}_mz"]) / (limit * c.a)
    print(
        f"FASTSIM {bound} a/b {ratio}: force {error.max():.4f} mu N, moment {moment_error.max():.4f} mu N a"
    )
    assert error.max() <= 0.01
    assert moment_error.max() <= 0.01


@pytest.mark.parametrize("ratio", RATIOS)
def test_polach_against_half_space(ratio: str) -> None:
    """At most 10 % of mu N up to a spin of 0.1 1/m, 13 % up to 0.2, mean over all rows at most 7 %."""
    rows = table(f"creep_forces_aob{ratio}.csv")
    fx, fy = polach_on(rows, float(ratio), rows["mu"])
    error = np.hypot(fx - rows["hs_fx"], fy - rows["hs_fy"]) / (rows["mu"] * NORMAL)
    for spin in np.unique(rows["spin"]):
        worst = error[rows["spin"] == spin].max()
        print(f"Polach a/b {ratio}, spin {spin} 1/m: at most {worst:.3f} mu N")
    print(f"Polach a/b {ratio}: mean {error.mean():.3f} mu N")
    assert error[rows["spin"] <= 0.1].max() <= 0.10
    assert error[rows["spin"] <= 0.2].max() <= 0.13
    assert error.mean() <= 0.07


@pytest.mark.parametrize("ratio", RATIOS)
def test_polach_initial_slope(ratio: str) -> None:
    """Slope within 2 % of G a b C, and within 3 % of the extrapolated table at its smallest creepages."""
    c = contact(float(ratio))
    area = SHEAR_MODULUS * c.a * c.b
    rows = table("creep_forces_extrapolated.csv")
    single = (rows["xi"] != 0).astype(int) + (rows["eta"] != 0) + (rows["spin"] != 0) == 1
    small = (rows["xi"] <= 1e-4) & (rows["eta"] <= 1e-4) & (np.abs(rows["spin"]) <= 0.05)
    rows = rows[(rows["a_over_b"] == float(ratio)) & single & small]
    assert len(rows) == 3
    fx, fy = polach_on(rows, float(ratio), np.full(3, 0.3))
    linear = -area * np.array(
        [
            c.coefficients[0] * rows["xi"][0],
            c.coefficients[1] * rows["eta"][1],
            c.coefficients[2] * rows["spin"][2] * math.sqrt(c.a * c.b),
        ]
    )
    tiny = rows.copy()
    for name in ("xi", "eta", "spin"):
        tiny[name] *= 1e-4
    slope_x, slope_y = polach_on(tiny, float(ratio), np.full(3, 0.3))
    np.testing.assert_allclose(1e4 * np.array([slope_x[0], slope_y[1], slope_y[2]]), linear, rtol=0.02)
    found = np.array([fx[0], fy[1], fy[2]])
    expected = np.array([rows["fx"][0], rows["fy"][1], rows["fy"][2]])
    print(f"Polach a/b {ratio}, small creepage over extrapolated: {found / expected - 1.0}")
    np.testing.assert_allclose(found, expected, rtol=0.03)


@pytest.mark.parametrize("ratio", RATIOS)
def test_polach_linear_and_coulomb(ratio: str) -> None:
    """Kalker's linear forces at small, Coulomb's at large creepage, always against the creepage."""
    c = contact(float(ratio))
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    for size in (1e-7, 1e-3, 10.0):
        xi, eta = size * np.cos(angle), size * np.sin(angle)
        fx, fy = polach_forces(xi, eta, 0.0, NORMAL, c.a, c.b, c.coefficients, 0.3, SHEAR_MODULUS)
        force = np.hypot(fx, fy)
        np.testing.assert_allclose(fx * xi + fy * eta, -force * size, rtol=1e-12)
        if size == 1e-7:
            slope = np.hypot(c.coefficients[0] * xi, c.coefficients[1] * eta)
            np.testing.assert_allclose(force, SHEAR_MODULUS * c.a * c.b * slope, rtol=1e-3)
        if size == 10.0:
            np.testing.assert_allclose(force, 0.3 * NORMAL, rtol=1e-6)


def by_table(rows: NDArray[np.void], ratio: float, friction: Array) -> Array:
    c = contact(ratio)
    found = creep.creep_forces(
        "table",
        rows["xi"],
        rows["eta"],
        rows["spin"],
        NORMAL,
        c.a,
        c.b,
        friction,
        SHEAR_MODULUS,
        POISSON,
    )
    return found[:2]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize(("kind", "mean", "largest"), [("par", 0.02, 0.06), ("hs", 0.03, None)])
def test_table_against_contact(ratio: str, kind: str, mean: float, largest: float | None) -> None:
    """All rows: mean 2 % and largest 6 % of mu N to CONTACT's FASTSIM, mean 3 % to its half-space."""
    rows = table(f"creep_forces_aob{ratio}.csv")
    fx, fy = by_table(rows, float(ratio), rows["mu"])
    error = np.hypot(fx - rows[f"{kind}_fx"], fy - rows[f"{kind}_fy"]) / (rows["mu"] * NORMAL)
    print(f"table against {kind}, a/b {ratio}: mean {error.mean():.4f}, largest {error.max():.4f} mu N")
    assert error.mean() <= mean
    assert largest is None or error.max() <= largest


@pytest.mark.parametrize("ratio", RATIOS)
def test_bounds_against_half_space(ratio: str) -> None:
    """Why the bound is parabolic: CONTACT's own rows with it lie nearer to its half-space in the mean."""
    rows = table(f"creep_forces_aob{ratio}.csv")
    error = {
        bound: np.hypot(rows[f"{bound}_fx"] - rows["hs_fx"], rows[f"{bound}_fy"] - rows["hs_fy"])
        / (rows["mu"] * NORMAL)
        for bound in ("par", "ell")
    }
    for bound, values in error.items():
        print(f"FASTSIM {bound} against half-space, a/b {ratio}: mean {values.mean():.4f} mu N")
    assert error["par"].mean() < error["ell"].mean()


@pytest.mark.parametrize("ratio", RATIOS)
def test_table_against_extrapolated_half_space(ratio: str) -> None:
    """The most exact rows: mean 3 % of mu N, and 3 % of the force at the smallest creepages."""
    rows = table("creep_forces_extrapolated.csv")
    rows = rows[rows["a_over_b"] == float(ratio)]
    fx, fy = by_table(rows, float(ratio), np.full(len(rows), 0.3))
    error = np.hypot(fx - rows["fx"], fy - rows["fy"]) / (0.3 * NORMAL)
    print(f"table against extrapolated half-space, a/b {ratio}: mean {error.mean():.4f} mu N")
    assert error.mean() <= 0.03
    small = (rows["xi"] <= 1e-4) & (rows["eta"] <= 1e-4) & (np.abs(rows["spin"]) <= 0.05)
    found, expected = np.array([fx, fy])[:, small], np.array([rows["fx"], rows["fy"]])[:, small]
    largest = np.abs(expected).max(axis=0)
    assert np.all(np.abs(found - expected) <= 0.03 * largest)


def fastsim_forces(x: Array, shear_modulus: float, elements: int) -> Array:
    """Forces over mu N of contacts in the columns of x, as the time loop's laws read them, by FASTSIM."""
    n = x.shape[1]
    out = np.empty(creep.ROWS_OUT * n)
    creep.fastsim_rows(x.ravel(), out, creep.scratch(n), np.array([float(elements)]), shear_modulus)
    return np.asarray(out.reshape(creep.ROWS_OUT, n)[:2] / x[creep.BOUND])


@pytest.mark.parametrize("ratio", [0.07, 0.12, 0.2, 0.3, 0.7, 1.3, 2.0, 3.0, 4.0, 5.0, 7.0])
def test_table_against_fastsim_at_other_ratios(ratio: float) -> None:
    """Random creepages, spin to 1 1/m, and FASTSIM on 128 x 128 elements: mean 2 %, largest 6 % of mu N.

    Below a/b 1/10, where Kalker's own table ends, largest 9 %.
    """
    rng = np.random.default_rng(7)
    n, c = 3000, contact(ratio)
    xi = 10.0 ** rng.uniform(-5.0, -2.0, (2, n)) * rng.choice((-1.0, 1.0), (2, n))
    spin, normal = rng.uniform(-1.0, 1.0, n), NORMAL * rng.uniform(0.3, 1.7, n)
    size = np.cbrt(normal / NORMAL)
    a, b, friction = c.a * size, c.b * size, rng.uniform(0.2, 0.5, n)
    rows = (*xi, spin, friction * normal, a, b, *c.coefficients)
    x = np.array([np.broadcast_to(row, n) for row in rows])
    exact = fastsim_forces(x, SHEAR_MODULUS, 128)
    found = creep.creep_forces("table", xi[0], xi[1], spin, normal, a, b, friction, SHEAR_MODULUS, POISSON)
    error = np.hypot(*(found[:2] / x[creep.BOUND] - exact))
    print(f"table against FASTSIM, a/b {ratio}: mean {error.mean():.4f}, largest {error.max():.4f} mu N")
    assert error.mean() <= 0.02
    assert error.max() <= (0.06 if ratio >= 0.1 else 0.09)


@pytest.mark.parametrize("wear", [0.0, 1.0])
def test_table_along_runs(wear: float) -> None:
    """The contacts of the packaged vehicle over 5 km at 200 to 400 km/h: mean 2 %, largest 6 % of mu N.

    Measured: 0.07 % in the mean on new and 0.14 % on worn wheels, 1.9 % at most; the regression on FASTSIM's
    forces is right to 0.5 % (measured 0.1 %). Polach's law errs by 3.0 % and 7.6 % in the mean, 53 % at most.
    The choice of the traction bound matters more: in the mean at least five times as much as the table.
    """
    model = VehicleModel(load_scenario(None, [f"wear={wear}", "contact.creep_law=table"]))
    shear, poisson = model.scenario.contact.shear_modulus, model.scenario.contact.poisson_ratio
    kept = []
    for speed in (200.0, 300.0, 350.0, 400.0):
        simulator = Simulator(model, speed / 3.6, seed=1)
        simulator.run(500.0)
        for _ in range(60):
            simulator.run(5000.0 / 60)
            kept.append(simulator.work.creep_in.reshape(creep.ROWS_IN, -1).copy())
    x = np.concatenate(kept, axis=1)
    x = np.ascontiguousarray(x[:, x[creep.BOUND] > 0.0])
    exact = fastsim_forces(x, shear, 128)
    n = x.shape[1]
    elliptic = np.array([fastsim(*column, 1.0, shear, 128, 128)[:2] for column in x.T]).T
    bound = np.hypot(*(elliptic / x[creep.BOUND] - exact))
    print(f"elliptic bound, wear {wear:g}: mean {bound.mean():.4f}, largest {bound.max():.4f} mu N")
    error, found = {}, np.empty(creep.ROWS_OUT * n)
    for law, kernel in (("table", creep.table_rows), ("polach", creep.polach_rows)):
        kernel(x.ravel(), found, creep.scratch(n), creep.law_table(law, poisson), shear)
        difference = found.reshape(creep.ROWS_OUT, n)[:2] / x[creep.BOUND] - exact
        error[law] = np.hypot(*difference)
        bias = np.sum(difference * exact) / np.sum(exact * exact)
        print(
            f"{law}, wear {wear:g}: mean {error[law].mean():.4f}, largest {error[law].max():.4f} mu N, "
            f"bias {bias:+.4f}"
        )
        if law == "table":
            assert abs(bias) <= 0.005
    assert error["table"].mean() <= 0.02
    assert error["table"].max() <= 0.06
    assert error["table"].mean() < 0.1 * error["polach"].mean()
    assert error["table"].mean() < 0.2 * bound.mean()
