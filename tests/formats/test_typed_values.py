"""One rule for values: what capture.toml may hold is what a command line may say, spelt out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import pytest

from pipeline.errors import UserError
from pipeline.formats.typed_values import filled, typed


@pytest.mark.parametrize(
    ("kind", "value", "written", "wanted"),
    [
        (bool, True, "true", True),
        (bool, False, "False", False),
        (int, 500, "500", 500),
        (int, 1e3, "1e3", 1000),
        (float, 2, "2", 2.0),
        (float, 0.5, "5e-1", 0.5),
        (float | None, 0.5, "0.5", 0.5),
        (str, "1", "1", "1"),
        (Literal["auto", "on"], "on", "on", "on"),
        (tuple[float, ...], [1, 2.5], "1, 2.5", (1.0, 2.5)),
    ],
)
def test_a_value_in_toml_is_what_is_written_in_a_call(kind: Any, value: Any, written: str, wanted: Any) -> None:
    for found in (typed(value, kind, "a.b", "capture.toml"), typed(written, kind, "a.b", "PARAMS", text=True)):
        assert found == wanted and type(found) is type(wanted)


def test_an_optional_value_is_taken_away_by_none_in_a_call_alone() -> None:
    assert typed("none", float | None, "a.b", "PARAMS", text=True) is None
    with pytest.raises(UserError, match="not a number"):
        typed("none", float | None, "a.b", "capture.toml")


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("kind", "value", "fault"),
    [
        (bool, "yes", "true or false"),
        (bool, "1", "true or false"),
        (bool, 1, "true or false"),
        (bool, "on", "true or false"),
        (int, "1.5", "a whole number"),
        (int, 1.5, "a whole number"),
        (int, "inf", "a whole number"),
        (int, True, "a whole number"),
        (float, "a", "a number"),
        (float, True, "a number"),
        (float, [1], "a number"),
        (tuple[float, ...], 1, "a list"),
        (dict[str, float], "x", "a table"),
        (Literal["auto", "on"], "of", "unknown"),
    ],
)
def test_what_is_doubtful_is_refused_in_both(kind: Any, value: Any, fault: str, text: bool) -> None:
    with pytest.raises(UserError, match=fault) as caught:
        typed(value, kind, "stage.name", "place", text)
    assert str(caught.value).startswith("place: stage.name = ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [1e308, -1e39, 1e-50])
def test_numbers_that_single_precision_makes_infinite_or_zero_are_refused(value: float) -> None:
    for given, text in ((value, False), (str(value), True)):
        with pytest.raises(UserError, match="single precision"):
            typed(given, float, "a.b", "place", text)
    assert typed(0.0, float, "a.b", "place") == 0 and typed(-1e30, float, "a.b", "place") == -1e30


@pytest.mark.parametrize(
    ("kind", "value"), [(int, "500"), (float, "0.5"), (bool, "true"), (tuple[float, ...], "1 2"), (str, 5)]
)
def test_toml_values_of_another_type_are_refused(kind: Any, value: Any) -> None:
    with pytest.raises(UserError):
        typed(value, kind, "a.b", "capture.toml")


@dataclass(frozen=True)
class Inner:
    scale: float = 1.0


@dataclass(frozen=True)
class Outer:
    inner: Inner = Inner()
    by_name: dict[str, Inner] = field(default_factory=dict)
    path: str | None = None


def test_tables_fill_dataclasses_and_unknown_keys_are_named_with_their_place() -> None:
    table = {"inner": {"scale": 2}, "by_name": {"a": {"scale": 3.0}}}
    assert filled(Outer, table, "", "x") == Outer(Inner(2.0), {"a": Inner(3.0)})
    for wrong, name in (
        ({"inner": {"size": 1}}, "inner.size"),
        ({"by_name": {"a": {"b": 1}}}, "by_name.a.b"),
        ({"path": "x"}, "path"),
    ):
        with pytest.raises(UserError, match=f"unknown key {name}"):
            filled(Outer, wrong, "", "x", hidden=("path",))
