"""Validation metric of ASME V&V 20-2009: comparison error against its uncertainty.

With the simulated value S and the reference D, the comparison error is E = S − D, and the error of the model lies in

    E ± 2 u_val,        u_val² = u_num² + u_input² + u_reference²

(coverage factor 2, about 95 %). If the size of E is below u_val, the error of the model cannot be told from the noise
of the comparison; if it is far above, it is E. If both sides solve the same equations with the same inputs, u_input
is 0, and the comparison is a verification.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["COVERAGE", "Uncertainty"]

COVERAGE = 2.0


@dataclass(frozen=True)
class Uncertainty:
    """Standard uncertainties of a comparison, in the unit of the measured error.

    Attributes
    ----------
    num : float
        Of the simulation: mesh, iteration, samples.
    input : float
        Of its inputs.
    reference : float
        Of the reference.
    """

    num: float = 0.0
    input: float = 0.0
    reference: float = 0.0

    @property
    def total(self) -> float:
        """u_val."""
        return math.sqrt(self.num**2 + self.input**2 + self.reference**2)

    def metric(self, error: float) -> float:
        """Size of E over u_val; infinite for an error without any uncertainty."""
        if self.total == 0:
            return math.inf if error else 0.0
        return abs(error) / self.total

    def over(self, scale: float) -> Uncertainty:
        """The uncertainties relative to a scale."""
        return Uncertainty(self.num / scale, self.input / scale, self.reference / scale)

    def record(self, error: float) -> dict[str, float | None]:
        """The uncertainties, the metric, and the largest error of the model, JSON-ready."""
        values = {
            "num": self.num,
            "input": self.input,
            "reference": self.reference,
            "total": self.total,
            "metric": self.metric(error),
            "model_error": abs(error) + COVERAGE * self.total,
        }
        return {name: float(value) if math.isfinite(value) else None for name, value in values.items()}
