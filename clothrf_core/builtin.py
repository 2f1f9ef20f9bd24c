"""The core's own components; they enter by the same door as everybody's."""

from __future__ import annotations
