"""Uniform cubic B-spline over the position along the track: interpolation and evaluation."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from scipy.ndimage import spline_filter1d

from sayd_env.config.units import Array
from sayd_env.physics.kernel import instructions, kernel

CHANNELS = 4
"""Alignment, vertical, cross-level, gauge."""


def interpolation_coefficients(samples: Array) -> Array:
    """Coefficients of the cubic B-spline that passes through samples on a uniform grid.

    Parameters
    ----------
    samples : ndarray, shape (n, channels)
        Values at x0, x0 + step, ...; at least four rows.

    Returns
    -------
    ndarray, shape (n + 2, channels)
        C-contiguous; rows i to i + 3 carry the interval from sample i to sample i + 1. The spline has zero
        slope at both ends.

    Notes
    -----
    Solves c[i-1] + 4 c[i] + c[i+1] = 6 s[i] with mirrored ends by `scipy.ndimage.spline_filter1d`
    (Unser 1999, "Splines: a perfect fit for signal and image processing").
    """
    inner = spline_filter1d(samples, order=3, axis=0, mode="mirror")
    return np.ascontiguousarray(np.pad(inner, ((1, 1), (0, 0)), mode="reflect"))


@kernel(inline=True)
def spline_weights(
    count: int, x0: float, per_step: float, x: float
) -> tuple[int, float, float, float, float, float, float, float, float]:
    """Weights of the four coefficients that matter at one position.

    Parameters
    ----------
    count : int
        Number of coefficients.
    x0, per_step : float
        Position of the first sample (m), 1 / distance of the samples (1/m).
    x : float
        Position (m). Outside the table the value at its end holds and the slope is zero.

    Returns
    -------
    tuple
        Index of the first coefficient, four weights of the value, four of the slope d/dx (1/m).
    """
    last = count - 4
    end = last + 1.0
    u = (x - x0) * per_step
    slope_scale = per_step
    # Written so that NaN, too, ends at the table's start: an index out of bounds is never formed.
    if not 0.0 <= u <= end:
        slope_scale = 0.0
        u = end if u > end else 0.0
    i = min(int(u), last)
    t = u - i
    s = 1.0 - t
    return (
        i,
        s * s * s / 6.0,
        2.0 / 3.0 - 0.5 * t * t * (2.0 - t),
        2.0 / 3.0 - 0.5 * s * s * (2.0 - s),
        t * t * t / 6.0,
        -0.5 * s * s * slope_scale,
        0.5 * t * (3.0 * t - 4.0) * slope_scale,
        -0.5 * s * (3.0 * s - 4.0) * slope_scale,
        0.5 * t * t * slope_scale,
    )


def _plain_weighted_rows(
    coefficients: Array,
    first: int,
    weights: tuple[float, float, float, float],
    out: Array,
    place: int,
    stride: int,
) -> None:
    rows = coefficients[first : first + len(weights) * CHANNELS].reshape(len(weights), CHANNELS)
    w0, w1, w2, w3 = weights
    out[place : place + CHANNELS * stride : stride] = (
        w0 * rows[0] + w1 * rows[1] + w2 * rows[2] + w3 * rows[3]
    )


@instructions(_plain_weighted_rows)
def weighted_rows(
    _context: Any,
    coefficients: Any,
    first: Any,
    weights: Any,
    out: Any,
    place: Any,
    stride: Any,
) -> Any:
    """Weighted sum of four rows of four channels, the channels side by side in a vector register.

    ``weighted_rows(coefficients, first, (w0, w1, w2, w3), out, place, stride)``: coefficients is flat, row by
    row, `first` the place of the first row's first number; channel c goes to ``out[place + c * stride]``. (A
    loop over four channels is too short for LLVM's own vectoriser.)
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def data(k: int) -> Any:
            return context.make_array(signature.args[k])(context, builder, arguments[k]).data

        def integer(k: int) -> Any:
            return context.cast(builder, arguments[k], signature.args[k], types.intp)

        vector, word = ir.VectorType(ir.DoubleType(), CHANNELS), ir.IntType(32)
        empty, mask = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(word, CHANNELS), [0] * 4)
        base, at, total = data(0), integer(1), None
        for k in range(CHANNELS):
            row = builder.gep(base, [builder.add(at, ir.Constant(at.type, k * CHANNELS))])
            values = builder.load(builder.bitcast(row, vector.as_pointer()), align=8)
            weight = builder.insert_element(
                empty, builder.extract_value(arguments[2], k), ir.Constant(word, 0)
            )
            product = builder.fmul(builder.shuffle_vector(weight, empty, mask), values)
            total = product if total is None else builder.fadd(total, product)
        target, where, stride_ = data(3), integer(4), integer(5)
        for c in range(CHANNELS):
            element = builder.extract_element(total, ir.Constant(word, c))
            offset = builder.add(where, builder.mul(stride_, ir.Constant(where.type, c)))
            builder.store(element, builder.gep(target, [offset]))
        return context.get_dummy_value()

    return types.void(coefficients, first, weights, out, place, stride), codegen


@kernel
def spline_value_slope(
    coefficients: Array, x0: float, step: float, x: float, out_value: Array, out_slope: Array
) -> None:
    """Values and slopes of the four channels at one position.

    Parameters
    ----------
    coefficients : ndarray, shape (n, 4)
        Of `interpolation_coefficients`.
    x0, step : float
        Position of the first sample, distance of the samples (m).
    x : float
        Position (m). Outside the table the value at its end holds and the slope is zero.
    out_value, out_slope : ndarray, shape (4,)
        Filled with the values (m, m, rad, m) and their derivatives over x.
    """
    i, w0, w1, w2, w3, d0, d1, d2, d3 = spline_weights(coefficients.shape[0], x0, 1.0 / step, x)
    flat = coefficients.reshape(-1)
    weighted_rows(flat, CHANNELS * i, (w0, w1, w2, w3), out_value, 0, 1)
    weighted_rows(flat, CHANNELS * i, (d0, d1, d2, d3), out_slope, 0, 1)


@kernel
def spline_table(
    coefficients: Array, x0: float, step: float, x: Array, out_value: Array, out_slope: Array
) -> None:
    """`spline_value_slope` at many positions: x of shape (m,), outputs of shape (m, 4)."""
    for k in range(x.shape[0]):
        spline_value_slope(coefficients, x0, step, x[k], out_value[k], out_slope[k])
