"""Settings of the stability assessment by EN 14363."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import model_validator

from sayd_env.config.base import Model, quantity
from sayd_env.config.layers import Kind, read_layered

ASSESSMENT = Kind("study")


class AssessmentConfig(Model):
    """How a signal is assessed. The limits follow from the vehicle, see `sayd_env.stability.limits`."""

    run_in: float = quantity("m", "distance at the start that is not assessed", ge=0)
    length: float | None = quantity("m", "assessed distance; null: all that follows the run-in", gt=0)
    sample_rate: float = quantity("Hz", "rate at which simulated signals are sampled", gt=0, le=2e4)
    minimum_sample_rate: float = quantity("Hz", "lowest sampling rate of a recording", gt=0)

    segment_length: float = quantity("m", "distance of one spectrum", ge=1.0)
    segment_overlap: float = quantity("-", "share of a segment that the next one repeats", ge=0, le=0.99)
    frequency_min: float = quantity("Hz", "lowest dominant frequency", gt=0)
    frequency_max: float = quantity("Hz", "highest dominant frequency", gt=0, le=1e3)
    frequency_step: float = quantity("Hz", "step of the fixed frequency grid", ge=1e-3)

    band_half_width: float = quantity("Hz", "the pass band reaches this far to both sides of f_0", gt=0)
    band_min: float = quantity("Hz", "lowest edge of the pass band", gt=0)
    filter_order: int = quantity("-", "order of the Butterworth prototype", ge=1, le=10)
    filter_padding: float = quantity("s", "mirrored signal in front of and behind the filtered one", ge=0)

    window_length: float = quantity("m", "window of the sliding RMS", ge=0.1)
    window_step: float = quantity("m", "step of the sliding RMS", ge=0.01)

    grid_tolerance: float = quantity(
        "m/s", "a critical speed that moves further on another speed grid is sensitive to the grid", gt=0
    )

    @model_validator(mode="after")
    def _consistent(self) -> AssessmentConfig:
        if self.frequency_max < self.frequency_min + 4 * self.frequency_step:
            raise ValueError(
                f"frequency_max ({self.frequency_max:g} Hz) must exceed frequency_min"
                f" ({self.frequency_min:g} Hz) by at least four frequency_step ({self.frequency_step:g} Hz)"
            )
        if self.frequency_min <= self.frequency_step:
            raise ValueError("frequency_min must exceed frequency_step")
        if self.band_min >= self.frequency_min + self.band_half_width:
            raise ValueError("band_min must lie below frequency_min + band_half_width")
        highest = self.frequency_max + self.band_half_width
        if self.minimum_sample_rate <= 2 * highest or self.sample_rate < self.minimum_sample_rate:
            raise ValueError(
                "needs sample_rate >= minimum_sample_rate > 2 (frequency_max + band_half_width)"
                f" = {2 * highest:g} Hz"
            )
        if self.length is not None and self.length < max(self.segment_length, self.window_length):
            raise ValueError("length must hold at least one segment and one window")
        return self


def load_assessment(name: str = "en14363", overrides: Iterable[str] = ()) -> AssessmentConfig:
    """Read the settings of the assessment.

    Parameters
    ----------
    name : str
        A packaged study (``en14363``) or a path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    return read_layered(AssessmentConfig, ASSESSMENT, name, overrides)
