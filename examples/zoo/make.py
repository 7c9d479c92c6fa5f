"""Write the policies of the zoo: networks of the layout and size that public projects use, with random weights.

    python examples/zoo/make.py            # all of them
    python examples/zoo/make.py navrep     # one

No weights of others are in them; they do not drive well, and are not meant to. The weights are multiples of 2^-8, so
that the files compress.
"""

from __future__ import annotations

import sys
import zlib
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

HERE = Path(__file__).resolve().parent


def perceptron(
    *sizes: int, hidden: type[nn.Module] = nn.ReLU, last: nn.Module | None = None
) -> nn.Sequential:
    """Return dense layers with an activation between them."""
    layers: list[nn.Module] = []
    for given, taken in pairwise(sizes):
        layers += [nn.Linear(given, taken), hidden()]
    layers[-1] = last or nn.Identity()
    return nn.Sequential(*layers)


class ScanNet(nn.Module):
    """A scan through 1-D convolutions, joined with the other numbers, through dense layers."""

    def __init__(
        self,
        channels: int,
        rays: int,
        others: int,
        convolutions: nn.Module,
        dense: nn.Module,
        embedded: int = 0,
    ) -> None:
        super().__init__()
        self.channels, self.rays, self.others = channels, rays, others
        self.convolutions, self.dense = convolutions, dense
        self.embed = nn.Linear(others, embedded) if embedded else nn.Identity()

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action."""
        size = self.channels * self.rays
        scan = observation[:, :size].reshape(-1, self.channels, self.rays)
        others = self.embed(observation[:, size:])
        return self.dense(torch.cat([self.convolutions(scan).flatten(1), others], dim=1))


class SpeedAndTurn(nn.Module):
    """A speed between 0 and 1, and a turn between -1 and 1."""

    def forward(self, outputs: Tensor) -> Tensor:
        """Squash both."""
        return torch.cat([torch.sigmoid(outputs[:, :1]), torch.tanh(outputs[:, 1:])], dim=1)


class Neighbours(nn.Module):
    """The robot's own state, and what a GRU makes of its neighbours."""

    def __init__(self, own: int, neighbours: int, each: int, hidden: int) -> None:
        super().__init__()
        self.own, self.neighbours, self.each = own, neighbours, each
        self.gru = nn.GRU(each, hidden, batch_first=True)
        self.dense = perceptron(own + hidden, 256, 256, 3, last=nn.Tanh())

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action."""
        around = observation[:, self.own :].reshape(-1, self.neighbours, self.each)
        _, last = self.gru(around)
        return self.dense(torch.cat([observation[:, : self.own], last[0]], dim=1))


class Recurrent(nn.Module):
    """One step of an LSTM, whose state is given and taken, and dense layers behind it."""

    def __init__(self, observed: int, hidden: int) -> None:
        super().__init__()
        self.hidden = hidden
        self.lstm = nn.LSTM(observed, hidden)
        self.dense = perceptron(hidden, 64, 2, hidden=nn.Tanh, last=nn.Tanh())

    def forward(self, observation: Tensor, h: Tensor, c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the action, and the state of the step after."""
        outputs, (h, c) = self.lstm(observation.unsqueeze(0), (h, c))
        return self.dense(outputs[0]), h, c


class Normalised(nn.Module):
    """Running mean and deviation before a policy, and a clip of its actions behind it, as deployed."""

    def __init__(self, policy: nn.Sequential, low: list[float], high: list[float]) -> None:
        super().__init__()
        self.policy, size = policy, policy[0].in_features
        self.register_buffer("mean", torch.linspace(0.5, 2.0, size))
        self.register_buffer("deviation", torch.linspace(0.5, 1.5, size))
        self.register_buffer("low", torch.tensor(low))
        self.register_buffer("high", torch.tensor(high))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action in physical units."""
        normal = torch.clamp((observation - self.mean) / self.deviation, -10.0, 10.0)
        squashed = torch.clamp(self.policy(normal), -1.0, 1.0)
        return self.low + 0.5 * (squashed + 1.0) * (self.high - self.low)


def _irsim() -> nn.Module:
    convolutions = nn.Sequential(
        nn.Conv1d(1, 4, 8, 4),
        nn.LeakyReLU(),
        nn.Conv1d(4, 8, 8, 4),
        nn.LeakyReLU(),
        nn.Conv1d(8, 4, 4, 2),
        nn.LeakyReLU(),
    )
    return ScanNet(
        1, 180, 5, convolutions, perceptron(36, 400, 300, 2, hidden=nn.LeakyReLU, last=nn.Tanh()), 20
    )


def _collision_avoidance() -> nn.Module:
    convolutions = nn.Sequential(
        nn.Conv1d(3, 32, 5, 2, 1), nn.ReLU(), nn.Conv1d(32, 32, 3, 2, 1), nn.ReLU(), nn.Flatten(), nn.Linear(4096, 256),
        nn.ReLU(),
    )  # fmt: skip
    return ScanNet(3, 512, 4, convolutions, perceptron(260, 128, 2, last=SpeedAndTurn()))


def _navrep() -> nn.Module:
    convolutions = nn.Sequential(
        nn.Conv1d(1, 16, 8, 4), nn.ReLU(), nn.Conv1d(16, 16, 9, 4), nn.ReLU(), nn.Conv1d(16, 16, 6, 4), nn.ReLU(),
        nn.Flatten(), nn.Linear(256, 32),
    )  # fmt: skip
    return ScanNet(1, 1080, 5, convolutions, perceptron(37, 64, 64, 3, hidden=nn.Tanh, last=nn.Tanh()))


LAYOUTS = {
    "drl_robot_navigation": (24, lambda: perceptron(24, 800, 600, 2, last=nn.Tanh())),
    "drl_robot_navigation_ros2": (25, lambda: perceptron(25, 400, 300, 2, last=nn.Tanh())),
    "drl_robot_navigation_irsim": (185, _irsim),
    "turtlebot3_drlnav": (44, lambda: perceptron(44, 512, 512, 2, last=nn.Tanh())),
    "robotis_dqn": (26, lambda: perceptron(26, 512, 256, 128, 5)),
    "arena_unicycle": (365, lambda: perceptron(365, 128, 64, 64, 2, hidden=nn.Tanh, last=nn.Tanh())),
    "arena_holonomic": (365, lambda: perceptron(365, 128, 64, 64, 3, hidden=nn.Tanh, last=nn.Tanh())),
    "navrep": (1085, _navrep),
    "rl_collision_avoidance": (1540, _collision_avoidance),
    "ros_jackal": (722, lambda: perceptron(722, 512, 512, 2, last=nn.Tanh())),
    "f1tenth_drl": (41, lambda: perceptron(41, 100, 100, 2, last=nn.Tanh())),
    "isaac_lab_navigation": (10, lambda: perceptron(10, 128, 128, 3, hidden=nn.ELU)),
    "rl_rvo_nav": (46, lambda: Neighbours(6, 5, 8, 64)),
    "metadrive": (259, lambda: perceptron(259, 256, 256, 2, hidden=nn.Tanh, last=nn.Tanh())),
    "sb3_vecnormalize": (
        38,
        lambda: Normalised(perceptron(38, 64, 64, 2, hidden=nn.Tanh), [0.0, -2.0], [0.22, 2.0]),
    ),
    "sb3_recurrent": (28, lambda: Recurrent(28, 64)),
    "archcomp_nav": (4, lambda: perceptron(4, 64, 32, 2, last=nn.Tanh())),
}
"""For each directory the number of inputs, and what makes the network."""


def make(name: str) -> Path:
    """Write the policy of a layout, the same every time, and return its path."""
    size, build = LAYOUTS[name]
    torch.manual_seed(zlib.crc32(name.encode()))
    network = build().eval()
    with torch.no_grad():
        for weight in network.parameters():
            weight.copy_(torch.round(weight * 256) / 256)
    path = HERE / name / "policy.onnx"
    states = ["h", "c"] if isinstance(network, Recurrent) else []
    given = (torch.zeros(1, size), *(torch.zeros(1, 1, network.hidden) for _ in states))
    made = [f"{state}_out" for state in states]
    torch.onnx.export(
        network, given, path, input_names=["observation", *states], output_names=["action", *made], opset_version=17,
        dynamic_axes={
            **{value: {0: "batch"} for value in ("observation", "action")},
            **{value: {1: "batch"} for value in (*states, *made)},
        },
        dynamo=False,
    )  # fmt: skip
    return path


if __name__ == "__main__":
    for chosen in sys.argv[1:] or LAYOUTS:
        print(make(chosen))
