"""Options that have another name than before: they still do what they did, and the new name is told."""

from dataclasses import dataclass, field

import pytest

from tests.helpers.command_line import EVERY_COMMAND, main
from vapor.commands.console import parse
from vapor.commands.renamed_options import RENAMED, with_new_names


@dataclass(frozen=True)
class Inner:
    """A group of options."""

    ewta_fraction: float = 0.0
    """How long."""
    store_float16: bool = True
    """Whether."""


@dataclass(frozen=True)
class Options:
    """A command."""

    ema_decay: float = 0.5
    """How much."""
    store_float16: bool = True
    """Whether."""
    name: str = ""
    """Any words."""
    train: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("words", "expected", "told"),
    [
        (["--average", "0.25"], Options(ema_decay=0.25), ["--average is now --ema-decay"]),
        (["--average=0.25"], Options(ema_decay=0.25), ["--average is now --ema-decay"]),
        (["--no-half"], Options(store_float16=False), ["--no-half is now --no-store-float16"]),
        (
            ["--train.evolve", "0.4", "--train.no-half"],
            Options(train=Inner(0.4, False)),
            ["--train.evolve is now --train.ewta-fraction", "--train.no-half is now --train.no-store-float16"],
        ),
        (["--average", "0.1", "--average", "0.2"], Options(ema_decay=0.2), ["--average is now --ema-decay"]),
        (["--name", "average", "--ema-decay", "0.1"], Options(ema_decay=0.1, name="average"), []),
    ],
)
def test_an_old_name_does_what_it_did_and_the_new_one_is_told(words, expected, told, capsys):
    assert parse("try", Options, words) == expected
    assert capsys.readouterr().err.splitlines() == [f"vapor-track try: {each}" for each in told]


def test_words_of_an_option_may_have_underscores():
    old = "--train.validation_share"
    assert with_new_names([old, "0.2"])[0] == ["--train.validation-fraction", "0.2"]


def test_a_wrong_value_is_told_by_the_new_name(capsys):
    with pytest.raises(SystemExit, match="2"):
        parse("try", Options, ["--average", "much"])
    assert "--ema-decay" in capsys.readouterr().err


@pytest.mark.parametrize("words", EVERY_COMMAND, ids=" ".join)
def test_no_command_has_an_option_by_an_old_name_which_it_could_not_be_given(words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    options = {word.strip(",|[]").rpartition(".")[2] for word in capsys.readouterr().out.split() if "--" in word}
    names = {f"--{option.removeprefix('--').removeprefix('no-')}" for option in options}
    assert not names & RENAMED.keys()


def test_words_behind_two_dashes_are_no_options():
    assert with_new_names(["--half", "--", "--half"]) == (
        ["--store-float16", "--", "--half"],
        ["--half is now --store-float16"],
    )
