"""The recipes of docs/extending.md, followed to the letter on a copy of the package."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

COPIED = ("petmjx", "docs", "sweeps", "tests", "README.md", "CHANGELOG.md", "pyproject.toml")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
SECTION = re.compile(r"^## (.+)$", flags=re.MULTILINE)


@dataclass(frozen=True)
class Copy:
    """A copy of the repository in which the recipes are followed."""

    folder: Path
    document: str

    def blocks(self, section: str, language: str) -> list[str]:
        """The code blocks in a language of a section of docs/extending.md."""
        _, *parts = SECTION.split(self.document)
        sections = dict(zip(parts[::2], parts[1::2], strict=True))
        return [body for name, body in BLOCK.findall(sections[section]) if name == language]

    def change(self, diff: str) -> None:
        """Apply a diff of the page. The lines of a diff without a mark show the place of the change; ``@@`` separates
        two places in a file."""
        for change in re.split(r"^--- ", diff, flags=re.MULTILINE)[1:]:
            name, _, body = change.partition("\n")
            path = self.folder / name
            for hunk in re.split(r"^@@\n", body, flags=re.MULTILINE):
                lines = hunk.splitlines(keepends=True)
                old = "".join(line[1:] for line in lines if not line.startswith("+"))
                new = "".join(line[1:] for line in lines if not line.startswith("-"))
                text = path.read_text(encoding="utf-8")
                assert text.count(old) == 1, f"docs/extending.md changes what is not in {name}, or twice:\n{old}"
                path.write_text(text.replace(old, new), encoding="utf-8")

    def follow(self, section: str) -> None:
        for diff in self.blocks(section, "diff"):
            self.change(diff)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(self.folder), str(self.folder / "tests")))}
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False)

    def printed_by(self, program: str) -> str:
        done = self.run("-c", program)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def failing(self, *tests: str) -> Sequence[str]:
        """The names of the tests that fail."""
        done = self.run("-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)
        names = re.findall(r"^(?:FAILED|ERROR) \S+::(\S+)", done.stdout, flags=re.MULTILINE)
        assert bool(names) == bool(done.returncode), done.stdout + done.stderr
        return names


@pytest.fixture
def copy(tmp_path: Path, repository: Path) -> Copy:
    for name in COPIED:
        source, target = repository / name, tmp_path / name
        if source.is_dir():
            # bytecode is copied, too: it is valid for a source with the same date and size
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("*.png", "*.gif"))
        else:
            shutil.copy(source, target)
    return Copy(tmp_path, (repository / "docs" / "extending.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("sections", "most"),
    [
        (["A column of your own"], 3),
        (["A property of boxes of your own"], 3),
        (["A criterion of your own"], 1),
        (["A reason of your own"], 1),
        (["A column of your own", "A reason of your own"], 4),
        (["A value for pairs of materials of your own"], 4),
    ],
)
def test_recipes_touch_few_files(sections: list[str], most: int, repository: Path) -> None:
    followed = Copy(repository, (repository / "docs" / "extending.md").read_text(encoding="utf-8"))
    diffs = "".join(diff for section in sections for diff in followed.blocks(section, "diff"))
    files = re.findall(r"^--- (petmjx/\S+)$", diffs, flags=re.MULTILINE)
    assert 0 < len(set(files)) <= most, files


STACK = """
import numpy as np
import petmjx
plan = petmjx.Plan.from_boxes(
    "stack", size_mm=[(400, 300, 200)] * 3, corner_mm=[(0, 0, 200 * k) for k in range(3)], mass_kg=[5.0] * 3
)
"""


def test_an_engine_by_name(copy: Copy) -> None:
    engine = "An engine of your own"
    program, _ = copy.blocks(engine, "python")
    (copy.folder / "petmjx/engines/centre_rule.py").write_text(program, encoding="utf-8")
    copy.follow(engine)
    printed = copy.printed_by(
        f"{STACK}from petmjx.show import doctor_report\n"
        "run = petmjx.score(plan, engine='centre-rule')\n"
        "print(run.worlds[['engine', 'verdict']].iloc[0].tolist())\n"
        # other engines take long to examine
        "doctor_report.ENGINES = [name for name in doctor_report.ENGINES if name == 'centre-rule']\n"
        "print([report.works for report in doctor_report.examine().engines])\n"
    )
    assert "['centre-rule', 'stable']\n[True]" in printed


def test_a_profile(copy: Copy) -> None:
    copy.follow("A profile of your own")
    (copy.folder / "nudge.toml").write_text('[axes]\nprofile = "nudge"\nscale = [0.1, 30.0]\n', encoding="utf-8")
    printed = copy.printed_by(
        f"{STACK}print(petmjx.sweep('nudge.toml', plan, engine='mujoco').worlds.set_index('scale').verdict.to_dict())"
    )
    assert "{0.1: 'stable', 30.0: 'unstable'}" in printed


SPEEDS = """
import petmjx
from petmjx.common.processes import claim_process
claim_process()  # as in the command, MJX is imported without its kernels of Warp: a second and a half less
from support.fake_stepper import FakeEngine
import warp
from petmjx.analysis.story_in_words import first_box_in_words, reason_in_words
from petmjx.engines.warp.engine import MjxWarpEngine
warp.config.optimization_level = 0  # the kernel runs only for moments, and takes half as long to compile
plan = petmjx.Plan.from_boxes(
    "falls", size_mm=[(400, 300, 200)] * 2, corner_mm=[(0, 0, 0), (500, 0, 100)], mass_kg=[5.0] * 2
)
options = dict(check="static", duration_s=0.2, sample_interval_s=0.02)
def scored(engine, **thresholds):
    return petmjx.score(plan, engine=engine, thresholds=dict(shift_m=1, **thresholds), **options, record="all")
kernels = MjxWarpEngine(1, allow_cpu=True)
exact, other, still = (scored(engine).boxes.max_speed for engine in ("mujoco", kernels, FakeEngine()))
print("speeds:", 1.0 < exact[1] < 1.5, exact[0] < 0.1, abs(other - exact).max() < 1e-3, still.tolist())
for engine in ("mujoco", kernels):
    run = scored(engine, speed_m_s=0.5)
    (world,) = run.worlds.itertuples()
    print([world.verdict, world.reason, int(world.culprit)], abs(1 - world.margin - exact[1] / 0.5) < 0.01)
story = petmjx.tell("falls", scored("mujoco", speed_m_s=0.5))
print(reason_in_words(story), "|", first_box_in_words(story))
pallets = petmjx.Pallets(1, engine="mujoco", sample_interval_s=0.02, thresholds={"speed_m_s": 0.0001})
print(pallets.place(size_mm=[(400, 300, 200)], corner_mm=[(0, 0, 0)], mass_kg=[5.0]).reason.tolist())
"""
"""A program that prints the metric of the recipe, and what follows from the reason. A box falls by 100 mm."""


def test_a_metric_and_a_reason(copy: Copy) -> None:
    """Array programs are tested with the rules of mjx-jax on a stepper that moves no box, since compiling MJX takes
    half a minute."""
    pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    copy.follow("A column of your own")
    decided, known = copy.blocks("A reason of your own", "diff")
    tests = ("tests/unit/test_metrics.py", "tests/unit/test_docs.py", "-k", "tables or reason or words or rules_name")
    copy.change(decided)
    printed = copy.printed_by(SPEEDS)
    assert "speeds: True True True [0.0, 0.0]" in printed, printed
    assert printed.count("['unstable', 'speed', 1] True") == 2, printed
    assert "a box was faster than 0.5 m/s | Box 1 was planned 100 mm in the air and failed first: it was" in printed
    assert "['speed']" in printed, printed
    assert set(copy.failing(*tests)) == {
        "test_the_documentation_has_the_tables_of_the_spec",
        "test_the_documentation_has_all_flags_and_reasons_in_their_order",
        "test_the_rules_name_every_option_of_a_run",
    }
    copy.change(known)
    assert copy.failing(*tests) == ["test_the_documentation_has_the_tables_of_the_spec"]


def test_a_property_of_boxes(copy: Copy) -> None:
    copy.follow("A property of boxes of your own")
    printed = copy.printed_by(
        """
import numpy as np
import petmjx
from petmjx.results.plan_digests import plan_digest
from petmjx.world.mujoco_model import build_spec
from petmjx.world.scene import build_scenes
boxes = dict(size_mm=[(400, 300, 200)] * 2, corner_mm=[(0, 0, 0), (0, 0, 200)], mass_kg=[5.0] * 2)
plan = petmjx.Plan.from_boxes("stack", **boxes, friction=[0.3, None])
for name in ("plans.json", "plans.csv", "plans.parquet"):
    petmjx.save_plans(plan, name)
    print(petmjx.load_plans(name).plans[0].friction.tolist())
sim = petmjx.Simulation()
model = build_spec(next(build_scenes([plan], sim)), sim.physics).compile()
print(model.geom_friction[-2:, 0].tolist(), plan_digest(plan) != plan_digest(petmjx.Plan.from_boxes("stack", **boxes)))
"""
    )
    assert printed.count("[0.3, nan]\n") == 3
    assert "[0.3, 0.5] True" in printed


def test_a_value_for_pairs_of_materials(copy: Copy) -> None:
    """Contacts with a low damping ratio are stiff, and a box that overlaps another one a little is pushed out fast."""
    copy.follow("A value for pairs of materials of your own")
    printed = copy.printed_by(
        """
from dataclasses import replace
import petmjx
boxes = dict(size_mm=[(400, 300, 200)] * 2, corner_mm=[(0, 0, 0), (0, 0, 199.9)], mass_kg=[5.0] * 2)
plan = petmjx.Plan.from_boxes("p", **boxes)
plan = replace(plan, materials=("cardboard", "film"))
options = dict(engine="mujoco", check="static", duration_s=0.1, sample_interval_s=0.02)
pairs = [dict(between=("film", "cardboard"), friction=0.5)]
def push(**options_of_pairs):
    return petmjx.score(plan, **options, friction_pairs=pairs, **options_of_pairs).boxes.max_lin_acc[1]
usual, none, low = (push(landing_pairs=[dict(between=("film", "cardboard"), damping=d)]) for d in (1.25, None, 0.1))
print(usual == none == push(), usual < 0.01, low > 10)
"""
    )
    assert "True True True" in printed


def test_a_criterion(copy: Copy) -> None:
    copy.follow("A criterion of your own")
    printed = copy.printed_by(
        """
import petmjx
boxes = dict(size_mm=[(400, 300, 200)] * 2, corner_mm=[(0, 0, 0), (0, 0, 200)])
plans = [petmjx.Plan.from_boxes(f"top-{kg}", **boxes, mass_kg=[5.0, kg]) for kg in (4.0, 6.0)]
print(petmjx.criteria(plans, only=["light_on_heavy"]).plans.set_index("plan_id").light_on_heavy.to_dict())
"""
    )
    assert "{'top-4.0': True, 'top-6.0': False}" in printed
