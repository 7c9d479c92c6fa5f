"""One flat, typed description of a training run; presets, YAML files and ``key=value`` overrides.

Every field is documented at its declaration. The command line offers ``--preset NAME``,
``--config FILE.yaml``, ``--map``, ``--seeds``, ``--seed`` and ``--set key=value`` (repeatable); later ones
win over earlier ones.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from viatool.errors import ConfigurationError
from viatool.train.constraint import MultiplierRule, VarRule
from viatool.train.networks import HiddenActivation
from viatool.train.observation import ActorLayout
from viatool.train.presets import PRESETS, preset_options
from viatool.train.reachability import ENCLOSED

Count = Annotated[int, Field(ge=1)]
Whole = Annotated[int, Field(ge=0)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]
Discount = Annotated[FiniteFloat, Field(gt=0, lt=1)]
ShapingForm = Literal["potential", "progress"]
BudgetRule = Literal["recursive", "fixed"]
ShapingPath = Literal["straight", "around"]
WidthForm = Literal["mean", "square"]
SaturationForm = Literal["clip", "soft"]
Selection = Literal["success", "safety", "missions"]
Engine = Literal["kinematic", "bullet"]
MethodName = Literal["td3", "td7", "rcpo", "sac-lag", "wcsac", "cvar-cpo", "via"]


def _option(default: Any, description: str) -> Any:
    return Field(default=default, description=description)


class TrainingConfiguration(BaseModel):
    """Everything that decides what a training run does; the defaults are those of the preset ``quick``."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    # What is trained, and where
    method: MethodName = _option("via", "how costs enter the training, see docs/methods.md")
    map: str | tuple[str, ...] = _option(
        "lab", "map file or name, or a list of them that share the robots; generators draw the scenarios"
    )
    robot: str | None = _option(
        None, "known robot whose limits and body count on every map instead of the map's; null is the map's"
    )
    max_linear: Positive | None = _option(
        None, "m/s, the largest speed of the robot instead of the map's; null is the map's"
    )
    engine: Engine = _option(
        "kinematic",
        "exact arcs, or 'bullet', wheels in a physics world (use few robots)",
    )
    engine_workers: Count = _option(1, "processes of the physics engine; results do not depend on it")
    seed: Whole = _option(0, "seed of every random number of the run")
    seeds: Count = _option(3, "S, policies trained side by side; the best one is exported")

    # How long
    epochs: Count = _option(40, "K, epochs; after each one u and lambda are updated")
    epoch_steps: Count | None = _option(100, "steps of every robot in an epoch")
    epoch_episodes: Count | None = _option(
        None, "instead of epoch_steps: an epoch ends when every seed has finished this many episodes"
    )
    robots: Count = _option(64, "E, simulated robots of each seed")
    updates_per_step: Count = _option(8, "updates of the critics after each step of the robots")
    updates_per_episode: Count | None = _option(
        None, "instead of updates_per_step: updates for each episode that a seed finishes, on average"
    )
    horizon: Count = _option(300, "steps after which an episode is truncated")
    warmup_episodes: Whole = _option(64, "N, episodes of the initial policy whose costs give u0")
    learning_starts: Whole = _option(640, "transitions of each seed to collect before the first update")

    # Networks
    actor_hidden: tuple[Count, ...] = _option((26, 26), "widths of the actor's hidden layers")
    actor_activation: HiddenActivation = _option("relu", "of the actor's hidden layers; its output is tanh")
    lidar_range: Positive | None = _option(
        None,
        "metres up to which the actor sees: min(reading, lidar_range) inside the exported program; null is no limit",
    )
    lidar_saturation: SaturationForm = _option(
        "clip",
        "at lidar_range: 'clip' leaves nearer readings as they are, 'soft' is "
        "lidar_range / 2 * tanh(2 * min(reading, lidar_range) / lidar_range)",
    )
    observe_previous: bool = _option(
        True, "whether the actor observes the command of the step before; critics always do"
    )
    actor_output_scale: Positive = _option(0.1, "factor on the initial weights of the actor's last layer")
    saturation_penalty: NonNegative = _option(0.05, "weight of the actor's outputs deep in tanh's flat parts")
    critic_hidden: tuple[Count, ...] = _option((64, 64), "widths of the critics' hidden layers")
    near_features: bool = _option(True, "show the critics exp(-4 clearance) of every LiDAR bin as well")

    # TD3
    discount: Discount = _option(0.96, "gamma")
    learning_rate: Positive = _option(1e-3, "of Adam, for all networks")
    final_learning_rate: Fraction = _option(
        0.02, "learning rate at the end, as a fraction of the first; linear"
    )
    return_steps: Count = _option(5, "n of the n-step returns of both critics (the paper: 1)")
    batch_size: Count = _option(128, "transitions of each seed in one update")
    replay_capacity: Count = _option(200_000, "transitions of each seed that are kept")
    mirror: bool = _option(True, "learn from half of the transitions as seen in a mirror, left for right")
    policy_delay: Count = _option(2, "updates of the critics for one update of the actor and the targets")
    target_rate: Fraction = _option(0.005, "rho, how far the targets move towards their networks")
    target_noise: NonNegative = _option(0.2, "sigma of target policy smoothing, in [-1, 1] action units")
    target_noise_limit: NonNegative = _option(0.5, "c, at which the smoothing noise is clipped")
    noise_lowest: NonNegative = _option(
        0.02, "exploration noise of a seed's first robot, in [-1, 1] action units"
    )
    noise_highest: NonNegative = _option(0.5, "of its last robot; geometrically spaced between")

    embedding_size: Count = _option(32, "of TD7's codes of a state and of a state with an action")
    hard_target_interval: Count = _option(250, "of TD7: updates between two renewals of all targets")

    # CVaR constraint
    alpha: Discount = _option(0.9, "CVaR level: the worst 1 - alpha of the episodes count")
    cost_limit: Positive = _option(0.5, "b, limit of the CVaR of the episode cost")
    quantiles: Annotated[int, Field(ge=2)] = _option(20, "M, quantiles of the cost critic")
    huber_threshold: Positive = _option(1.0, "kappa of the quantile Huber loss")
    cost_critic_delay: Count = _option(2, "updates of the task critics for one update of the cost critic")
    budget_limit: Positive = _option(
        10.0, "budget e is clipped to this size and divided by it for the networks"
    )
    budget_rule: BudgetRule = _option(
        "fixed",
        "within an episode 'recursive' (the paper: e <- (e - c) / gamma), or 'fixed' at u, as in the exported policy",
    )
    var_step: NonNegative = _option(2.0, "beta_u")
    var_rule: VarRule = _option("adaptive", "'adaptive' (the paper) or 'empirical' (quantile of the epoch)")
    var_ceiling: Fraction = _option(0.9, "u is kept below this fraction of b")
    multiplier_initial: NonNegative = _option(0.2, "lambda_0")
    multiplier_step: NonNegative = _option(0.03, "beta_lambda")
    multiplier_maximum: NonNegative = _option(1.0, "lambda_max, in units of the scaled reward")
    multiplier_rule: MultiplierRule = _option(
        "mean", "'mean' (the paper: b - u - mean cost) or 'cvar' (b - CVaR)"
    )
    constraint_noise: NonNegative = _option(
        0.1,
        "u and lambda see the episodes of robots with at most this exploration noise",
    )

    # Reward
    reward_scale: Positive = _option(0.1, "factor on the reward before it is learnt")
    success_reward: NonNegative = _option(100.0, "for reaching the goal")
    collision_penalty: NonNegative = _option(100.0, "for a collision")
    turn_penalty: NonNegative = _option(0.05, "per rad/s and step (the paper's task: 0.5)")
    proximity_penalty: NonNegative = _option(
        0.25, "per metre below proximity_range and step (the paper's task: 0.5)"
    )
    proximity_range: NonNegative = _option(1.35, "metres")
    steering_penalty: NonNegative = _option(0.2, "per rad/s of change from one command to the next")
    standing_penalty: NonNegative = _option(
        0.5,
        "per step at a standstill, falling to 0 at 0.1 m/s",
    )
    shaping: NonNegative = _option(15.0, "potential-based shaping, per metre towards the goal; 0 is off")
    shaping_form: ShapingForm = _option(
        "progress",
        "'potential' leaves the best policy as it is; 'progress' pays metres gained, undiscounted",
    )
    shaping_path: ShapingPath = _option(
        "around", "metres to the goal are 'straight', or go 'around' the obstacles"
    )
    shaping_lookahead: NonNegative = _option(
        0.5, "metres; with 'around', the distance to go is measured from this far ahead of the robot"
    )
    shaping_narrow: NonNegative = _option(
        4.0,
        "with 'around', so many times longer is a metre within the danger clearance of an obstacle",
    )
    shaping_capped: bool = _option(
        True,
        "'progress' never pays more for a step than one in the open earns",
    )
    clearance_margin: NonNegative = _option(
        0.0,
        "metres added to both clearances while robots learn; evaluations have the map's",
    )
    curriculum_start: Positive = _option(
        20.0, "metres, largest distance of the goal at the start of the training"
    )
    curriculum_epochs: Whole = _option(
        0, "epochs over which that distance grows to curriculum_end; 0 turns the curriculum off"
    )
    curriculum_end: Positive = _option(20.0, "metres, largest distance of the goal when it has grown")

    # Verification in the loop
    reachability_weight: NonNegative = _option(
        0.0, "weight of the mean width of the actions' reachable sets in the actor's loss; 0 is off"
    )
    reachability_form: WidthForm = _option(
        "mean",
        "what of these widths counts: their 'mean', or mean 'square', which is about the wide ones",
    )
    reachability_start: Fraction = _option(0.0, "fraction of the run after which that weight begins to grow")
    reachability_full: Fraction = _option(
        0.0, "fraction of the run at which it is reached, linearly; at once where not above the start"
    )
    reachability_eps: NonNegative = _option(0.01, "sensor error of these sets, in every channel's unit")
    reachability_states: Count = _option(32, "states of each batch and seed whose sets are bounded")
    jump_penalty: NonNegative = _option(
        0.0,
        "weight in the actor's loss of the actions' change where one LiDAR bin reads what its neighbour does; 0 is off",
    )
    gain_limit: Positive | None = _option(
        None,
        "most by which an action, in [-1, 1], may change for an error of 1 in every channel's unit at once; "
        "null is no limit",
    )
    select_by: Selection = _option(
        "success",
        "best 'success', or among those about as good the best 'safety', or of the finalists about as good the most "
        "proved 'missions'",
    )
    select_on: Literal["random", "fixed"] = _option(
        "random", "scenarios that validate and choose: 'random' ones of their own, or the map's 'fixed' ones"
    )
    selection_tolerance: Fraction = _option(
        0.01, "how much success (minus collisions) may lack for about as good"
    )
    verification_scenarios: Whole = _option(
        0, "validation scenarios whose states are verified at every evaluation; 0 is off"
    )
    verification_eps: NonNegative = _option(0.01, "sensor error of that verification")

    mission_scenarios: Whole = _option(
        0, "further random scenarios whose missions are tried for each finalist; 0 is off"
    )
    mission_parts: Count = _option(1500, "most parts of the set of such a mission, which bounds its time")
    mission_feedback: Fraction = _option(
        0.0,
        "share of the episodes that begin where missions were not proved; 0 is off",
    )
    mission_interval: Count = _option(10, "epochs between two such trials")

    # Evaluation and records
    evaluation_interval: Count = _option(3, "epochs between evaluations")
    evaluation_start: Fraction = _option(0.7, "fraction of the run after which evaluations begin")
    validation_scenarios: Count = _option(200, "random scenarios on which every seed is evaluated")
    validation_seed: Whole = _option(1_000_001, "of the validation scenarios")
    finalists: Count = _option(
        4, "best (seed, epoch) pairs that are compared on the final validation scenarios"
    )
    final_scenarios: Count = _option(500, "further random scenarios that choose among the finalists")
    test_scenarios: Whole = _option(500, "random scenarios of the final evaluation, used for nothing else")
    test_seed: Whole = _option(2_000_003, "of the test scenarios")
    checkpoint_interval: Count = _option(5, "epochs between checkpoints; the last epoch always has one")
    state_interval: Count = _option(
        10, "epochs between saved states for resuming; the robots begin new episodes then"
    )
    tensorboard: bool = _option(True, "also write the metrics as TensorBoard events")

    @model_validator(mode="after")
    def _consistent(self) -> TrainingConfiguration:
        if not self.maps or len(set(self.maps)) < len(self.maps):
            raise ValueError(f"map {list(self.maps)} must name at least one map, and none twice")
        for name in ("robots", "validation_scenarios", "final_scenarios"):
            if getattr(self, name) < len(self.maps):
                raise ValueError(f"{name} {getattr(self, name)} is less than the {len(self.maps)} maps")
        if 0 < self.mission_scenarios < len(self.maps):
            raise ValueError(
                f"mission_scenarios {self.mission_scenarios} is less than the {len(self.maps)} maps"
            )
        if (self.epoch_steps is None) == (self.epoch_episodes is None):
            raise ValueError("give exactly one of epoch_steps and epoch_episodes, and null for the other")
        if self.select_by == "safety" and not self.verification_scenarios:
            raise ValueError("select_by: safety needs verification_scenarios, for example 20")
        if self.select_by == "missions" and not self.mission_scenarios:
            raise ValueError("select_by: missions needs mission_scenarios, for example 20")
        if self.mission_feedback and not self.mission_scenarios:
            raise ValueError("mission_feedback needs mission_scenarios, for example 5")
        if self.lidar_saturation == "soft" and self.lidar_range is None:
            raise ValueError("lidar_saturation: soft needs lidar_range, for example 2.5")
        if self.reachability_weight and self.actor_activation not in ENCLOSED:
            raise ValueError(f"reachability_weight needs actor_activation {' or '.join(ENCLOSED)}")
        if self.noise_highest < self.noise_lowest:
            raise ValueError(f"noise_highest {self.noise_highest} is below noise_lowest {self.noise_lowest}")
        if self.replay_capacity < max(self.learning_starts, self.robots):
            raise ValueError(
                f"replay_capacity {self.replay_capacity} holds less than learning_starts or one step"
            )
        if self.test_seed in range(self.validation_seed, self.validation_seed + 3):
            raise ValueError(
                "test_seed must differ from validation_seed and the next two numbers: they choose the policy"
            )
        return self

    @property
    def maps(self) -> tuple[str, ...]:
        """Files or names of all maps."""
        return (self.map,) if isinstance(self.map, str) else self.map

    @property
    def layout(self) -> ActorLayout:
        """What of an observation the actor sees."""
        return ActorLayout(self.lidar_range, self.observe_previous, self.lidar_saturation == "soft")

    def to_yaml(self) -> str:
        """Return the configuration as a YAML file that `load_configuration` reads."""
        import yaml

        text: str = yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)
        return text


def make_configuration(
    preset: str = "quick",
    file: str | os.PathLike[str] | None = None,
    settings: Sequence[str] = (),
    **overrides: Any,
) -> TrainingConfiguration:
    """Build a configuration; later sources win.

    Parameters
    ----------
    preset : str
        A name in `PRESETS`.
    file : path, optional
        YAML with any of the fields.
    settings : sequence of str
        ``key=value`` with the value in YAML, as from ``--set``.
    **overrides
        Fields by name; None means not given.

    Raises
    ------
    ConfigurationError
        For an unknown preset or key, a value that is out of range, or an unreadable file.
    """
    if preset not in PRESETS:
        raise ConfigurationError(f"there is no preset '{preset}'", f"choose one of {', '.join(PRESETS)}")
    chosen: dict[str, Any] = {} if file is None else _read_yaml(Path(file))
    chosen |= dict(_parse_setting(setting) for setting in settings)
    chosen |= {key: value for key, value in overrides.items() if value is not None}
    values = preset_options(preset, chosen.get("method", "via")) | chosen
    return _validated(values, f"configuration {file}" if file is not None else "training configuration")


def load_configuration(path: str | os.PathLike[str]) -> TrainingConfiguration:
    """Read a YAML file; fields that it does not name have their defaults.

    Raises
    ------
    ConfigurationError
        Names the file, the field and what was expected.
    """
    return _validated(_read_yaml(Path(path)), str(path))


def _validated(values: Mapping[str, Any], where: str) -> TrainingConfiguration:
    unknown = sorted(values.keys() - TrainingConfiguration.model_fields.keys())
    if unknown:
        raise ConfigurationError(f"{where}: unknown option {', '.join(unknown)}", _nearest(unknown[0]))
    try:
        return TrainingConfiguration.model_validate(dict(values))
    except ValidationError as error:
        findings = [
            f"{'.'.join(map(str, found['loc'])) or 'options'}: {found['msg'].removeprefix('Value error, ')}"
            for found in error.errors()
        ]
        raise ConfigurationError(
            f"{where}: {'; '.join(findings)}", "see docs/training.md for the options"
        ) from error


def _nearest(name: str) -> str:
    from difflib import get_close_matches

    close = get_close_matches(name, list(TrainingConfiguration.model_fields), n=1)
    return f"did you mean {close[0]}?" if close else "see docs/training.md for the options"


def _parse_setting(setting: str) -> tuple[str, Any]:
    import yaml

    key, equals, value = setting.partition("=")
    if not equals or not key.strip():
        raise ConfigurationError(f"setting '{setting}' is not key=value", "write for example --set epochs=20")
    try:
        return key.strip().replace("-", "_"), yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"setting '{setting}': the value is not YAML", "quote the value") from error


def _read_yaml(path: Path) -> dict[str, Any]:
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise ConfigurationError(f"cannot read {path}: {reason}", "give a YAML file") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        raise ConfigurationError(
            f"{path}{line}: not valid YAML", "see docs/training.md for an example"
        ) from error
    if content is None:
        return {}
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ConfigurationError(f"{path}: expected fields and values", "write for example `epochs: 20`")
    return content
