"""Two simulated controllers in a process of their own against the bridge end in this one."""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.connection import Connection

import numpy as np

from clothrf_core.errors import ClothrfError
from clothrf_core.provider import Figure
from clothrf_core.punctual import punctual
from clothrf_egm.config import EgmConfig
from clothrf_egm.controller import CYCLE_S, ControllerModel
from clothrf_egm.end import EgmEnd
from clothrf_egm.messages import (
    RobotMessage,
    SensorMessage,
    decode_robot,
    encode_robot,
    encode_sensor,
)
from clothrf_egm.simulator import EgmSimulator


def same_cycle(*, quick: bool) -> list[Figure]:
    """`egm_same_cycle_share`: share of EGM requests answered within 4 ms, by kernel time stamps."""
    seconds = 3.0 if quick else 30.0
    start = np.linspace(-0.3, 0.3, 14)
    process = multiprocessing.get_context("spawn")
    here, there = process.Pipe()
    puts = 0
    with punctual() as scheduling, EgmEnd(EgmConfig(left_port=0, right_port=0)) as end:
        controllers = process.Process(
            target=_controllers, args=(there, start, end.ports, seconds), daemon=True
        )
        controllers.start()
        there.close()
        tick = time.monotonic()
        while not here.poll():
            if end.measured() is not None:
                end.put(start + 0.1 * np.sin(0.5 * CYCLE_S * puts), np.zeros(14))
                puts += 1
            tick += CYCLE_S
            time.sleep(max(tick - time.monotonic(), 0.0))
        try:
            counters = here.recv()
        except EOFError as error:
            raise ClothrfError("the simulated controllers ended early; see above") from error
        health = end.health()
        controllers.join()
    detail = {
        "requests": counters["left_requests"] + counters["right_requests"],
        "delay_us": counters["delay_us"],
        "delay_p99_us": counters["delay_p99_us"],
        "delay_max_us": counters["delay_max_us"],
        "time_outs": counters["left_timeouts"] + counters["right_timeouts"],
        "lost": health["left_lost"] + health["right_lost"],
        "seconds": seconds,
        "scheduling": scheduling,
        "codec_us": 1e6 * _codec_s(2000 if quick else 10000),
    }
    return [Figure("egm_same_cycle_share", counters["same_cycle_share"], "share", detail)]


def _controllers(
    pipe: Connection, start: np.ndarray, ports: tuple[int, int], seconds: float
) -> None:
    simulator = EgmSimulator(ControllerModel(), start, host="127.0.0.1", ports=ports)
    simulator.run(seconds)
    pipe.send(simulator.counters())


def _codec_s(rounds: int) -> float:
    """CPU seconds to read one request and write one answer, median."""
    joints = (1.0, -2.0, 3.0, -4.0, 5.0, -6.0)
    request = encode_robot(RobotMessage(5, 20, joints, (7.0,)))
    answer = SensorMessage(5, 20, joints, (7.0,))
    times = np.empty(rounds)
    for i in range(rounds):
        begun = time.thread_time_ns()
        decode_robot(request)
        encode_sensor(answer)
        times[i] = time.thread_time_ns() - begun
    return float(np.median(times)) * 1e-9
