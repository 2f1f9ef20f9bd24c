"""`clothrf egm-sim`: the YuMi's controller, simulated."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from clothrf_core.config import read_rig
from clothrf_core.interfaces import ArmModel
from clothrf_core.provider import BuildContext
from clothrf_core.punctual import FIFO_PRIORITY, punctual
from clothrf_core.registry import Registry


def egm_sim_app() -> typer.Typer:
    """`clothrf egm-sim [OPTIONS]`."""
    app = typer.Typer(context_settings={"allow_interspersed_args": True})

    @app.callback(
        invoke_without_command=True, epilog="Example: clothrf egm-sim --comm-timeout 0.15"
    )
    def egm_sim(
        host: Annotated[str, typer.Option(help="where the bridge listens")] = "127.0.0.1",
        left_port: Annotated[int, typer.Option(help="its UDP port for the left arm")] = 6511,
        right_port: Annotated[int, typer.Option(help="its UDP port for the right arm")] = 6512,
        arm: Annotated[str, typer.Option(help="arm model whose ready posture to start at")] = (
            "yumi"
        ),
        rig: Annotated[Path | None, typer.Option(help="rig file with the rest corners")] = None,
        lag: Annotated[float, typer.Option(help="how far joints lag behind, s")] = 0.02,
        comm_timeout: Annotated[
            float, typer.Option(help="without an answer for this long a session ends, s")
        ] = 0.2,
        restart: Annotated[float, typer.Option(help="until a new one begins, s")] = 0.5,
        priority: Annotated[
            int, typer.Option(help="SCHED_FIFO where permitted, as a controller is; 0 = off")
        ] = FIFO_PRIORITY,
        seconds: Annotated[float, typer.Option(help="stop after; 0 = at Ctrl-C")] = 0.0,
        as_json: Annotated[bool, typer.Option("--json", help="print the counters as JSON")] = False,
    ) -> None:
        """Ask for both arms' next postures every 4 ms and follow them."""
        from clothrf_egm.controller import ControllerModel
        from clothrf_egm.simulator import EgmSimulator

        context = BuildContext(rig=None if rig is None else read_rig(rig))
        model: ArmModel = Registry.installed().build("arm", arm, None, context)
        simulator = EgmSimulator(
            ControllerModel(lag=lag, comm_timeout=comm_timeout, restart=restart),
            model.ready,
            host=host,
            ports=(left_port, right_port),
        )
        stop = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        with punctual(priority), simulator:
            if not as_json:
                print(f"egm-sim: asks {host}, UDP {left_port} and {right_port}; Ctrl-C ends it")
            stop.wait(seconds or None)
            counters = simulator.counters()
        print(json.dumps(counters) if as_json else _sentence(counters))

    return app


def _sentence(counters: Mapping[str, float]) -> str:
    requests = counters["left_requests"] + counters["right_requests"]
    timeouts = counters["left_timeouts"] + counters["right_timeouts"]
    speed = (
        f" (median {counters['delay_us']:.0f} us, p99 {counters['delay_p99_us']:.0f} us)"
        if "delay_us" in counters
        else ""
    )
    return (
        f"egm-sim: {requests:.0f} requests, {100 * counters['same_cycle_share']:.2f} % answered in "
        f"their own cycle{speed}, {timeouts:.0f} time-outs"
    )
