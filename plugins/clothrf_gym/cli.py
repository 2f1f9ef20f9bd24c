"""``clothrf gym``: the environments and how to make one."""

from __future__ import annotations

import typer
from rich.console import Console

app = typer.Typer(help="The cloth tasks as Gymnasium environments.")


@app.callback(invoke_without_command=True)
def gym() -> None:
    """List the registered environments."""
    from clothrf_core.errors import MissingDependency

    try:
        import gymnasium

        import clothrf_gym.envs
    except ImportError as error:
        raise MissingDependency(
            "the environments need 'gymnasium', which is not installed. "
            "Install it with: pip install 'clothrf[gym]'"
        ) from error
    console = Console()
    for name in sorted(n for n in gymnasium.registry if n.startswith("ClothRF/")):
        module = clothrf_gym.envs.__name__
        console.print(f'gymnasium.make("{module}:{name}")', highlight=False)
