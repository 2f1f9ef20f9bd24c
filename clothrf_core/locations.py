"""Where the shipped experiment files are: beside the packages in a wheel, or in the clone."""

from __future__ import annotations

from pathlib import Path

from clothrf_core.errors import ConfigError


def shipped(name: str) -> Path:
    """The path of a shipped config, as ``demo.toml`` or ``rigs/yumi_sr300.toml``.

    Raises:
        ConfigError: there is none of that name.
    """
    here = Path(__file__).parent
    for folder in (here / "configs", here.parent / "configs"):
        if (folder / name).exists():
            return folder / name
    raise ConfigError(f"{name}: no such shipped config; look into the folder configs/")
