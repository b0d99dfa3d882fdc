"""The README's Python example runs as it stands, and its scene table lists what is shipped."""

import re
from pathlib import Path

import pytest

import diffeed

TEXT = (Path(__file__).parent.parent / "README.md").read_text()


@pytest.mark.slow
def test_python_example_runs(capsys):
    code, _ = re.findall(r"```python\n(.*?)```", TEXT, re.S)
    assert 20 <= len(code.strip().splitlines()) <= 30
    exec(compile(code, "README.md", "exec"), {})
    shown = capsys.readouterr().out
    assert "passed" in shown
    # 20 ms at 10 mm of radius: the lead edge gains 0.2 mm for each rad/s (clockwise is negative).
    slope = float(re.search(r"(-?[\d.]+) mm per rad/s", shown)[1])
    assert -0.25 < slope < -0.15


def test_scenes_listed_are_those_shipped():
    listed = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.M))
    assert listed == set(diffeed.shipped_scenes())
