"""Whole commands killed at random moments: what lies there then is whole, the old or the new, and a restart succeeds.

`KILLS=200` kills each command as often; the suite does so once.
"""

import multiprocessing
import os
import random
import shutil
from typing import Any

import pytest

from tests.helpers.full import some
from tests.helpers.killed_commands import CALLS, LOADED, Killing, write_inputs

KILLS = int(os.environ.get("KILLS", "1"))

NOTHING, OLD, LEFT = "nothing", "the result of before", "what the last kill left"


@pytest.fixture(scope="module")
def processes() -> Any:
    """Makes processes that have loaded all there is: they are forked from one that did."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(LOADED)
    first = found.Process(target=os.getpid)
    first.start()
    first.join()
    return found


@pytest.mark.parametrize("name", some(1, sorted(CALLS, key=["train"].__contains__, reverse=True)))
def test_a_command_killed_at_any_moment_leaves_what_is_whole_and_succeeds_when_restarted(name, processes, tmp_path):
    call, rng, old = CALLS[name], random.Random(f"{name} {KILLS}"), tmp_path / "old"
    write_inputs(tmp_path)
    killing = Killing(call, tmp_path, processes)
    needed_s, known = {NOTHING: killing.finish()}, killing.found()
    shutil.copytree(killing.out, old)
    needed_s[OLD] = killing.finish(*call.again) if call.again else needed_s[NOTHING]
    new = killing.found()
    known += new
    names = {each for each, _ in known}

    most_s, killed, unfinished, restarted = needed_s[OLD], 0, 0, 0
    while killed < KILLS:
        begin = rng.choice([NOTHING, OLD, LEFT])
        if begin != LEFT:
            killing.put_back(old if begin == OLD else None)
            most_s = needed_s[begin]
        before = {each for each, _ in killing.found()}
        killed += killing.kill(rng.uniform(0.0, most_s))
        found = killing.found()
        assert [each for each, what in found if each in names and (each, what) not in known] == []
        assert before & names <= {each for each, _ in found}
        unfinished += bool(killing.leftovers or {each for each, _ in found} - names)
        if rng.random() < 0.25 or killed == KILLS:
            killing.finish(*call.again)
            assert killing.leftovers == []
            found = killing.found()
            assert [each for each, what in found if (each, what) not in known] == []
            assert [each for each, what in new if each.count("/") == call.grows and (each, what) not in found] == []
            restarted += 1
    print(f"{name}: killed {killed} times, left something unfinished {unfinished} times, restarted {restarted} times")
