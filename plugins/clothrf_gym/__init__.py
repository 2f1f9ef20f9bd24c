"""The cloth tasks as Gymnasium environments.

``gymnasium.make("clothrf_gym.envs:ClothRF/Straight-v0")`` makes one; nothing is registered or
imported before that.
"""

from __future__ import annotations

from collections.abc import Sequence

import typer

from clothrf_core.hookspecs import hookimpl
from clothrf_core.provider import Command


@hookimpl
def clothrf_commands() -> Sequence[Command]:
    """The list of environments."""
    return [Command("gym", "list the Gymnasium environments", _command)]


def _command() -> typer.Typer:
    from clothrf_gym.cli import app

    return app
