"""Nouns, verbs and loops of clothrf. Start reading at `loop.py`, then `imitation.py`."""

__version__ = "0.1.0"
