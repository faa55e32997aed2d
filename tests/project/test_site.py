"""The documentation site, without building it (`make docs` does): nothing in it is stale, and nothing is missing."""

import re

import pytest

import vapor
from docs.extensions.command_help import PROGRAMS, command
from docs.extensions.pages import blocks, shell, unknown
from tests.helpers.checkout import CHECKOUT
from vapor.track import COMMANDS

DOCS = CHECKOUT / "docs"
PAGES = [CHECKOUT / "README.md", CHECKOUT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
NOT_CODE_OF_OURS = {"text", "console", "ini", "dockerfile", "yaml", "toml", "json", "xml"}
"""Languages of blocks that show a file or what a program prints: nothing in them is run."""


def name(page):
    return page.relative_to(CHECKOUT).as_posix()


@pytest.fixture(params=PAGES, ids=name)
def page(request):
    return request.param


def test_every_block_of_code_is_run_or_says_why_not(page):
    for block in blocks(page.read_text(encoding="utf-8")):
        if block.language.startswith("{") or block.language in NOT_CODE_OF_OURS | {"sh"}:
            continue  # a cell is run when the site is built, and commands are checked below
        assert block.language == "python", f"{name(page)}: a block of {block.language or 'no language'!r}"
        why = re.fullmatch(r"not run: \w.+|run by (tests/\S+\.py)", block.mark)
        assert why, f"{name(page)}: say above the block who runs it, as CONTRIBUTING.md asks:\n{block.text}"
        if why[1]:
            assert page.name in (CHECKOUT / why[1]).read_text(encoding="utf-8")


def test_commands_and_options_in_the_pages_exist(page):
    if page != DOCS / "changelog.md":
        found = [sentence for text in shell(page.read_text(encoding="utf-8")) for sentence in unknown(text)]
        assert not found, f"{name(page)}: {found}"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("vapor-track run a.mcap \\\n  --modell x  # --nonsense", "run has no option --modell"),
        ("for i in 1 2; do X=1 .venv/bin/vapor-track synthesise a; done", "vapor-track has no command 'synthesise'"),
        ("torchrun --nproc-per-node 2 -m vapor.track train a --epoch=3", "train has no option --epoch"),
        ("make demo && vapor-benchmark run a.mcap", "vapor-benchmark has no command 'run'"),
        ("vapor-benchmark regressors a --localizer.gap.action widen", "regressors has no option --localizer"),
    ],
)
def test_what_the_parser_does_not_know_is_found(text, found):
    assert [sentence.partition(".gap")[0] for sentence in unknown(text)] == [found]


def test_what_the_parser_knows_is_no_complaint():
    line = "vapor-track run a --model=x --no-recording | tee log; vapor-benchmark step --threads 2"
    assert [*unknown(f"{line}\nvapor-track --help")] == []


def test_every_command_has_its_page():
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "commands").glob("*.md")}
    assert pages.keys() == COMMANDS.keys()
    for each, text in pages.items():
        assert text.startswith(f"# vapor-track {each}\n")
        assert f"```{{command-help}} vapor-track {each}\n```" in text
    listed = "".join(f"| [{name}](commands/{name}.md) | {meaning} |\n" for name, meaning in COMMANDS.items())
    assert listed in (DOCS / "commands.md").read_text(encoding="utf-8")


def test_the_page_of_the_benchmarks_has_them_all():
    assert "```{command-help} vapor-benchmark\n```" in (DOCS / "benchmark.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("words", [f"{program} {name}" for program, of in PROGRAMS.items() for name in of.COMMANDS])
def test_the_page_of_a_command_explains_every_option(words):
    shown = command(words)
    assert shown.meaning
    for _, options in shown.groups.values():
        for option in options:
            assert option.help, f"{words} {option.names} has no help"
            assert option.names or option.value


def test_options_are_shown_with_value_default_and_group():
    shown = command("vapor-track run")
    options = {each.names[0]: each for _, group in shown.groups.values() for each in group if each.names}
    assert options["--model"].required
    assert (options["--workers"].value, options["--workers"].default) == ("INT", "1")
    assert options["--undistort"].names == ("--undistort", "--no-undistort")
    meaning, gap = shown.groups["localizer.gap"]
    assert meaning == "Motion where odometry is missing."
    assert next(each.names[0] for each in gap) == "--localizer.gap.action"


def test_defaults_that_follow_from_a_preset_are_those_of_its_command():
    (width,) = [
        option
        for _, options in command("vapor-benchmark regressors").groups.values()
        for option in options
        if "--train.network.image-width" in option.names
    ]
    assert width.default == str(vapor.PRESETS["demo"].network.image_width)
