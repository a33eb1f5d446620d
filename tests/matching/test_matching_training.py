"""Facts about training the learned score: nothing leaks from what is judged, and a model's own trees stay."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching import training
from vtrack_batch.matching.calibration import LabelledPair
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.score import Model, model_text
from vtrack_batch.matching.training import Lesson, train


def pair(seed: int, *, n: int = 40) -> LabelledPair:
    """Two streams on an oblong place, 12 m/s east and 9 m/s west, grey paint; some are missed, one is a false alarm."""
    rng = np.random.default_rng(seed)
    heading = np.where(rng.random(n) < 0.6, 1.0, -1.0)
    xy = np.column_stack([rng.uniform(0, 400, n), np.where(heading > 0, 0.0, 7.0) + rng.integers(0, 2, n) * 3.5])
    velocity = np.where(heading > 0, 12.0, -9.0) + rng.normal(0, 1.0, n)
    grey = rng.uniform(60, 180, (n, 1))
    images = []
    for t_s in (0.0, 1.5):
        seen = pd.DataFrame(xy + rng.normal(0, 0.3, xy.shape), columns=["x_m", "y_m"])
        seen["x_m"] += velocity * t_s
        seen[["red", "green", "blue"]] = grey + rng.normal(0, 3, (n, 3))
        seen["vehicle"] = [f"v{k}" for k in range(n)]
        seen = seen[rng.random(n) > 0.1].sample(frac=1, random_state=int(rng.integers(1000)))
        seen["detection_id"] = rng.permutation(len(seen)) + 100
        seen.loc[seen.index[:1], "vehicle"] = None
        images.append(seen)
    return LabelledPair(*images, 1.5)


@pytest.fixture(scope="module")
def lessons() -> list[Lesson]:
    return [Lesson.of(pair(seed), f"street {seed % 3}", None, MatchingParams()) for seed in range(18)]


def right_side(lesson: Lesson, p: np.ndarray) -> float:
    """How much likelier a true link is taken for than a false one: the area under the ROC curve."""
    true, false = p[lesson.true], p[~lesson.true]
    return float((true[:, None] > false).mean() + 0.5 * (true[:, None] == false).mean())


def test_links_unseen_are_told_apart_and_the_second_round_is_no_worse(lessons: list[Lesson]) -> None:
    made = train(lessons)
    one, two = (
        np.mean([right_side(*of) for of in zip(lessons, p, strict=True)]) for p in zip(*made.unseen, strict=True)
    )
    assert 0.97 < one < 1
    assert one - 0.005 < two < 1
    assert len(Model.parse(made.text, "made").rounds) == 2
    assert train(lessons).text == made.text


def test_what_is_judged_has_taught_nothing(lessons: list[Lesson]) -> None:
    rng = np.random.default_rng(5)
    # columns that know nothing of the truth: trees still fit what they were grown on, by heart
    shuffled = [replace(lesson, true=rng.permutation(lesson.true), base=rng.normal(size=lesson.base.shape),
                        heard=rng.normal(size=lesson.heard.shape)) for lesson in lessons]  # fmt: skip
    one = np.mean([right_side(lesson, p) for lesson, (p, _) in zip(shuffled, train(shuffled).unseen, strict=True)])
    assert 0.46 < one < 0.54


def test_trees_are_added_to_a_model_and_its_own_stay(lessons: list[Lesson]) -> None:
    begun = model_text(None)
    made = train(lessons, begun=begun)
    former, new = (json.loads(text)["rounds"] for text in (begun, made.text))
    for before, after in zip(former, new, strict=True):
        assert after[: len(before)] == before
        assert len(after) == len(before) + training.MORE_TREES
    x = lessons[0].first_round()
    changed = Model.parse(made.text, "made").rounds[0].probability(x) - Model.parse(begun, "begun").rounds[
        0
    ].probability(x)
    assert 0 < np.abs(changed).max() < 1


def test_too_little_is_refused_with_what_to_do(lessons: list[Lesson]) -> None:
    for few in (lessons[:2], [lesson for lesson in lessons if lesson.group == "street 0"], []):
        with pytest.raises(UnusableData, match="ask for more pairs"):
            train(few)


def test_without_lightgbm_the_extra_is_named(lessons: list[Lesson], monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        if name == "lightgbm":
            raise ImportError(name)
        return import_module(name)

    monkeypatch.setattr(training, "import_module", missing)
    with pytest.raises(ConfigError, match=r"vtrack-batch\[train\]"):
        train(lessons)
