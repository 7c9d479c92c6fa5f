"""Train a policy of the layout of ARCH-COMP's NAV or Unicycle, by gradients through the robot's motion.

    python examples/arch-comp/train.py nav nav.onnx
    viatool mission nav.onnx --spec examples/arch-comp/nav.yaml --map examples/arch-comp/nav-map.yaml

The benchmarks' own networks are at github.com/verivital/ARCH-COMP2024; this makes one of our own in half a minute. Runs
begin anywhere in the box of starts and a little around it, and every command errs a little, so that the policy pulls
its runs together, which is what keeps their set small.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

INTERVAL = 0.2


@dataclass(frozen=True)
class Task:
    """What one benchmark asks; states are x, y, heading and speed.

    Parameters
    ----------
    lower, upper : tuple of float
        The box of starts.
    seconds : float
        When the robot has to be at its goal.
    observed : tuple of int
        Places of the state in the order in which the network takes them.
    above : float
        By how much outputs are above commands.
    reach : tuple of float
        Half of the sides of the goal, around zero; infinite where any state will do.
    corner : tuple of float, optional
        A place to pass half-way, so as to go round the obstacle.
    obstacle : tuple of float, optional
        Lower and upper end of its sides.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    seconds: float
    observed: tuple[int, ...]
    above: float
    reach: tuple[float, ...]
    corner: tuple[float, float] | None = None
    obstacle: tuple[float, float] | None = None

    @property
    def steps(self) -> int:
        """Return how many intervals there are."""
        return round(self.seconds / INTERVAL)


ANY = float("inf")
TASKS = {
    "nav": Task(
        (2.9, 2.9, 0.0, 0.0), (3.1, 3.1, 0.0, 0.0), 6.0, (0, 1, 3, 2), 0.0, (0.5, 0.5, ANY, ANY), (2.6, 0.5), (1.0, 2.0)
    ),
    "unicycle": Task(
        (9.5, -4.5, 2.1, 1.5), (9.55, -4.45, 2.11, 1.51), 10.0, (0, 1, 2, 3), 20.0, (0.6, 0.2, 0.06, 0.3)
    ),
}  # fmt: skip


def moved(states: Tensor, commands: Tensor) -> Tensor:
    """Return states (R, 4) after commands (R, 2), acceleration and turn, were held for an interval (Simpson's rule)."""
    x, y, heading, speed = states.T
    acceleration, turn = commands.T
    shares = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))
    parts = [
        (weight * (speed + share * INTERVAL * acceleration), heading + share * INTERVAL * turn)
        for share, weight in shares
    ]
    x = x + INTERVAL * sum(pace * torch.cos(angle) for pace, angle in parts)
    y = y + INTERVAL * sum(pace * torch.sin(angle) for pace, angle in parts)
    return torch.stack([x, y, heading + INTERVAL * turn, speed + INTERVAL * acceleration], dim=1)


def loss_of(task: Task, policy: nn.Module, runs: int) -> Tensor:
    """Return what runs cost: not to arrive, to come near to the obstacle, to spread, and to command much."""
    lower, upper = torch.tensor(task.lower), torch.tensor(task.upper)
    states = lower + (upper - lower) * torch.rand(runs, 4) + 0.02 * torch.randn(runs, 4)
    cost = torch.zeros(())
    for step in range(task.steps):
        commands = policy(states[:, task.observed]) - task.above
        cost = cost + 0.002 * commands.square().mean()
        states = moved(states, commands + 0.1 * torch.randn(runs, 2))
        if task.obstacle is not None:
            low, high = task.obstacle
            inside = torch.minimum(states[:, :2] - low, high - states[:, :2]).amin(dim=1)
            cost = cost + 10.0 * torch.relu(inside + 0.3).square().mean()
        if task.corner is not None and step == task.steps // 2:
            cost = cost + 0.2 * (states[:, :2] - torch.tensor(task.corner)).square().sum(dim=1).mean()
    reach = torch.tensor(task.reach)
    return cost + (states / reach).square().sum(dim=1).mean() + 0.2 * (states / reach).var(dim=0).sum()


def train(task: Task, seed: int, updates: int) -> nn.Module:
    """Return a policy of 4 inputs, two layers of 32 rectifiers and 2 outputs."""
    torch.manual_seed(seed)
    policy = nn.Sequential(nn.Linear(4, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, 2))
    with torch.no_grad():
        policy[-1].weight.mul_(0.1)
        policy[-1].bias.fill_(task.above)
    optimizer = torch.optim.Adam(policy.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for update in range(updates):
        optimizer.zero_grad()
        loss = loss_of(task, policy, 64)
        loss.backward()
        nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if update % 100 == 0:
            print(f"update {update}: loss {loss.item():.3f}")
    return policy


def main() -> None:
    """Train and export."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", choices=TASKS)
    parser.add_argument("output", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--updates", type=int, default=800)
    given = parser.parse_args()
    policy = train(TASKS[given.task], given.seed, given.updates)
    names = {"input_names": ["state"], "output_names": ["command"]}
    free = {name: {0: "batch"} for name in ("state", "command")}
    given.output.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(policy, (torch.zeros(1, 4),), given.output, dynamic_axes=free, dynamo=False, **names)


if __name__ == "__main__":
    main()
