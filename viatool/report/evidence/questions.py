"""What reviewers ask, in our own words, and where in the folder the answer lies - or that it does not.

The rows say nothing of conformance: whether an answer is enough is for the reviewer to say.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReviewQuestion:
    """One question of a review.

    Parameters
    ----------
    text : str
        The question.
    asked_by : str
        Reviewers by which standards ask it.
    answer : str
        Where the answer lies.
    link : str
        A place on the page or a file of the folder; empty where the folder has no answer.
    """

    text: str
    asked_by: str
    answer: str
    link: str = ""


_ALL = "UL 4600, ISO 13482, ISO 3691-4"

QUESTIONS = (
    ReviewQuestion(
        "What exactly is claimed, and how much of it is shown?",
        "UL 4600",
        "claims, each with its figure",
        "#claims",
    ),
    ReviewQuestion(
        "On what does each claim rest, and who has checked that?",
        _ALL,
        "assumptions, the open ones first",
        "#assumptions",
    ),
    ReviewQuestion(
        "Within which limits of operation do the claims hold: places, speeds, sensors, errors?",
        _ALL,
        "what took effect, and who said so; the map among the inputs",
        "#premises",
    ),
    ReviewQuestion(
        "Which distance to people and things is kept, and how was it chosen?",
        "ISO 13482, ISO 3691-4",
        "the distances are among what took effect; how they were chosen is open",
        "#premises",
    ),
    ReviewQuestion(
        "How does the robot come to stand, and from which speed?",
        "ISO 13482, ISO 3691-4",
        "criterion and deceleration; only the criterion braking speaks of stops",
        "#premises",
    ),
    ReviewQuestion(
        "Where does it fail, and why?", _ALL, "counterexamples that can be replayed", "witnesses.json"
    ),
    ReviewQuestion("Where is nothing known?", "UL 4600", "states with the verdict unknown", "states.npz"),
    ReviewQuestion(
        "What if sensors err, or the pose is off?", _ALL, "eps and the terms of the error model", "#premises"
    ),
    ReviewQuestion(
        "What of it was driven, and what is proved?",
        "UL 4600",
        "the task (driven) apart from the rates (proved)",
        "report.json",
    ),
    ReviewQuestion(
        "Which learned component was it, to the bit?",
        "UL 4600",
        "the policy among the inputs, by its hash",
        "#inputs",
    ),
    ReviewQuestion(
        "Why may the tool be trusted?", "UL 4600", "what a checker without its engine confirms", "#recheck"
    ),
    ReviewQuestion(
        "Can somebody else repeat it?",
        _ALL,
        "inputs, versions, and the seed in the assumption on states",
        "#inputs",
    ),
    ReviewQuestion(
        "What of changes after this?",
        "UL 4600",
        "another policy or map has another hash, and needs evidence of its own",
        "#inputs",
    ),
    ReviewQuestion(
        "Are people detected, also those who move?",
        "ISO 13482, ISO 3691-4",
        "not here, but for what the error model bounds of moving things: perception is taken within its errors",
    ),
    ReviewQuestion(
        "What if hardware, brakes or communication fail?", _ALL, "not here: a healthy robot is assumed"
    ),
    ReviewQuestion(
        "Was the test drive long enough, and of the right places?",
        "UL 4600",
        "not here: states are those that were driven",
    ),
)
