"""Everything that can go wrong in a way the user can mend.

One base class, so that a program can catch all of it at once; each child is named for the fact.
A message says what was expected, what was found and what to do.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class ClothrfError(Exception):
    """Base of all errors that the command line prints as one line without a traceback."""


class ShapeError(ClothrfError):
    """An array does not have the shape or dtype that its noun promises."""


class ConfigError(ClothrfError):
    """A configuration file is wrong; the message lists every problem in it."""


class UnknownPlugin(ClothrfError):
    """No installed plugin offers the name that was asked for."""


class BrokenPlugin(ClothrfError):
    """A plugin was found but could not be imported; the reason is in the message."""


class MissingDependency(ClothrfError):
    """A plugin needs a package that is not installed; the message names the extra."""


class DataError(ClothrfError):
    """A file of a data set, policy or run folder is corrupt, foreign or incomplete."""


class StorageFull(ClothrfError):
    """The disk is full; what was finished before is intact."""


class FeatureMismatch(ClothrfError):
    """A policy was given features of other names than it was trained on."""


class StaleFrame(ClothrfError):
    """A camera delivered no new frame in time."""


class RefusedTarget(ClothrfError):
    """A motion target is unreachable, too far or not finite; the arms hold."""


class RolloutFailed(ClothrfError):
    """A roll-out could not be completed after all its attempts; the message names its seed."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """A sentence naming the nearest known name, and all of them: 'Did you mean ...? Known: ...'."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    hint = f"Did you mean '{near[0]}'? " if near else ""
    return f"{hint}Known: {', '.join(names) if names else 'none'}"
