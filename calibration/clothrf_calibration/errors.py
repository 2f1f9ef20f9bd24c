"""What can go wrong while calibrating, in a way that the user can mend."""

from __future__ import annotations

from clothrf_core.errors import ClothrfError


class CalibrationError(ClothrfError):
    """The pictures, poses or boards do not allow a calibration; the message says what to do."""


class BoardNotFound(CalibrationError):
    """A board was expected in the pictures and not found."""


class DegenerateData(CalibrationError):
    """The data leave some of the wanted numbers undetermined."""
