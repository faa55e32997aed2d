"""What installs the package, and says what it is, agrees with pyproject.toml and with what CI runs."""

import re
import tomllib

import yaml

from tests.helpers.checkout import CHECKOUT

PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_image_installs_by_the_script_that_ci_runs():
    ci = (CHECKOUT / ".ci" / "run").read_text(encoding="utf-8")
    image = (CHECKOUT / "Dockerfile").read_text(encoding="utf-8")
    assert re.search(r"^\.ci/install ", ci, re.MULTILINE)
    assert "COPY .ci/install /wheel/install" in image
    assert re.search(r"^RUN /wheel/install ", image, re.MULTILINE)
    assert re.search(r"^USER (?!root)\w+$", image, re.MULTILINE)
    python = re.findall(r"^FROM python:(3\.\d+)-slim", image, re.MULTILINE)
    assert f"Programming Language :: Python :: {python[-1]}" in PROJECT["classifiers"]


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((CHECKOUT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["title"].startswith(f"{PROJECT['name']}: ")
    assert {"cff-version", "message", "authors"} <= citation.keys()


def test_the_extra_all_has_every_other_one():
    extras = PROJECT["optional-dependencies"]
    (everything,) = extras["all"]
    assert set(re.findall(r"\w+", everything.partition("[")[2])) == extras.keys() - {"all"}


def test_the_page_of_installation_has_every_extra():
    page = (CHECKOUT / "docs" / "install.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert {*listed} >= PROJECT["optional-dependencies"].keys() - {"all"}


def test_every_python_that_is_promised_is_named_on_the_page_of_installation():
    promised = re.findall(r"Python :: (3\.\d+)", " ".join(PROJECT["classifiers"]))
    page = (CHECKOUT / "docs" / "install.md").read_text(encoding="utf-8")
    assert f"Python {', '.join(promised[:-1])} or {promised[-1]}" in page
    assert PROJECT["requires-python"] == f">={promised[0]}"
