"""The node of docs/online.md works, with ROS's modules played by ours."""

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from simulated_picks import simulated_picks

from sdp_vs_penalty.data import save

PAGE = Path(__file__).parents[2] / "docs" / "online.md"


class PlayedNode:
    """What the page's node uses of rclpy's."""

    def __init__(self, name: str) -> None:
        self.said: list[str] = []
        self.messages: list[SimpleNamespace] = []

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.messages.append)

    def create_subscription(self, kind, topic, callback, depth):
        assert topic == "joint_states"

    def get_logger(self):
        return SimpleNamespace(info=self.said.append)


def inertia_message(header):
    inertia = SimpleNamespace(m=0.0, com=SimpleNamespace())
    return SimpleNamespace(header=header, inertia=inertia)


def play_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": PlayedNode},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"InertiaStamped": inertia_message},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": SimpleNamespace},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)


def test_the_node_of_the_page_publishes_the_payload(panda, tmp_path, monkeypatch):
    play_ros(monkeypatch)
    monkeypatch.chdir(tmp_path)
    arm = simulated_picks(panda, 1.2, seed=5, rate=1000.0)
    arm.estimate.save("model.json")
    save(arm.calibration, "without_load.csv")
    text = PAGE.read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import numpy.*?)```", text, re.DOTALL)
    assert len([line for line in code.splitlines() if line]) <= 35
    names: dict[str, type] = {"__name__": "node"}
    exec(compile(code, "online.md", "exec"), names)
    node = names["PayloadNode"]()
    run = arm.stream(2.0).window(0.5, 3.0)
    for t, q, tau in zip(run.t, run.q[:, ::-1], run.tau[:, ::-1], strict=True):
        stamp = SimpleNamespace(sec=int(t), nanosec=round(1e9 * (t % 1.0)))
        node.take(
            SimpleNamespace(
                name=list(node.names[::-1]),
                position=q.tolist(),
                effort=tau.tolist(),
                header=SimpleNamespace(stamp=stamp),
            )
        )
    assert len(node.said) == 1
    assert node.said[0].startswith("picked up")
    last = node.messages[-1].inertia
    assert last.m == pytest.approx(arm.mass, rel=0.1)
    assert last.ixx > 0.0
