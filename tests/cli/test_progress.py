"""Progress on one line whose estimate of the end does not jump."""

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from structid.cli import console as module


@pytest.fixture
def shown(monkeypatch):
    """The words shown, and a clock that is set by hand."""
    now, words = [0.0], []
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now, words, module.RunProgress(2000, lambda _name, _done, _total, text: words.append(text))


def test_a_search_tells_no_end_that_nobody_knows(shown):
    now, words, run = shown
    for iteration in range(1, 4):
        run.search("output", iteration, 10.0 / iteration)
        now[0] += 2.0
    assert words[-1] == "output: iteration 3, 2 s each, misfit 3.333"


def test_the_end_of_tasks_counts_down_and_moves_only_with_the_pace(shown):
    now, words, run = shown
    for done in range(21):
        run.tasks("refits", done, 100)
        now[0] += 1.0 + 0.1 * (-1) ** done
    assert words[10] == "refits: 10 of 100, about 1:40 min left"
    assert words[20] == "refits: 20 of 100, about 1:30 min left"
    now[0] += 400.0
    run.tasks("refits", 21, 100)
    assert words[-1].startswith("refits: 21 of 100, about 26:")


def test_the_bar_of_the_task_named_last_is_the_only_one_shown():
    """Also of a task named a second time, whose clock starts anew."""
    now = [0.0]
    with Progress(console=Console(file=io.StringIO()), get_time=lambda: now[0], auto_refresh=False) as bar:
        show = module._bars(bar)
        for name, done in (("search", 3), ("mesh", 1), ("search", 1), ("search", 2)):
            now[0] += 10.0
            show(name, done, 3, f"{name} {done}")
            assert [task.description for task in bar.tasks if task.visible] == [f"{name} {done}"]
        assert bar.tasks[1].elapsed == 10.0
