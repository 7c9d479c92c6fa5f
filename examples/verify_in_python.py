"""Verify a policy from Python: look at the rates, find the states that matter, draw them, and decide.

Run it from the root of the repository, whole or, in an editor that knows ``# %%``, cell by cell.
"""

# %% The policy, the map, and how wrong the sensors may be
import numpy as np

import viatool

policy = viatool.load_policy("policies/via.onnx")
world_map = viatool.load_map("maps/lab.yaml")
print([channel.name for channel in policy.spec.observation])

# %% The map and its scenarios, as a matplotlib figure
viatool.draw_map(world_map)

# %% The main job: a notebook shows the rates of a result that ends a cell
result = viatool.verify(policy, world_map, eps={"": 0.01, "lidar": 0.03}, scenarios=world_map.scenarios[:3])
result

# %% Rates are integers: how many states are safe, of how many
overall = result.safety_rate.overall
print(f"{result.safety_rate}: {overall.total - overall.safe} states are not proved safe")
print(f"at the danger distance: {result.danger_rate}")

# %% The states as arrays, one row each
widths = result.upper - result.lower
worst = int(np.nanargmax(widths[:, 1]))
x, y, heading = result.poses[worst]
print(f"the sensors steer most at x {x:.2f} m, y {y:.2f} m: {widths[worst, 1]:.3f} rad/s")

# %% What the policy can be made to command there, for other sensor errors
for eps in (0.001, 0.01, 0.1):
    sets = viatool.reach(policy, result.observations[worst : worst + 1], policy.spec.radii({"": eps}))
    print(f"eps {eps}: omega from {sets.lower[0, 1]:.3f} to {sets.upper[0, 1]:.3f} rad/s")

# %% The run as a figure
figure = viatool.draw_result(result)

# %% The decision
safe_enough = overall.safe * 100 >= 95 * overall.total
print("safe enough to drive" if safe_enough else "not safe enough to drive")
