"""Train the packer ``learned`` from nothing, with physics in the loop.

    python examples/train_packer/train.py --out trained --seed 0 --minutes 20 --engine mjx-warp

1. The policy begins as a rule (rule.py).
2. The packer improves by itself on drawn orders (rollouts.py): CMA-ES searches its weights (search.py). The stability
   head, a network that estimates whether a placed box stands, takes the place of simulations.
3. At the same time, pallets are packed side by side in ``petmjx.Pallets``, by the policy, by rules and at random, as a
   robot would place the boxes. The simulated result of each placement is a label (labels.py, labeller.py).
4. After every ``--relabel`` updates, the head is fitted to all labels (head.py), and the next round of labels begins.

The folder ``--out`` stores the state of the training. The same command with ``--resume`` continues a stopped training,
with the same bits. ``--minutes`` limits the time; result.json has the number of updates that were made. With the same
number of ``--updates``, the weights are the same to the bit on the same machine, whatever ``--workers``. The program
needs no extra; figure.py draws the curves.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from head import believing, fit
from judge import judged
from labeller import Labeller
from rollouts import Outcome, outcomes, policy_worth, validated, with_linear
from rule import scaled, spread
from search import Search

from petmjx.common.machine import cpu_threads
from petmjx.common.processes import process_pool
from petmjx.packers.learned_packer import Policy
from petmjx.packers.policy_network import Network
from petmjx.plans.order_generator import stream

STREAM = 105
"""Key of the random numbers of the search."""


@dataclass(frozen=True)
class Plan:
    """Settings of a training. The weights depend only on these values."""

    seed: int
    updates: int
    orders: int
    candidates: int
    label_pallets: int
    label_steps: int
    rounds: int
    relabel: int
    measured: int
    fit_steps: int
    validate: int
    judge: int
    sigma: float
    patience_s: float
    engine: str


@dataclass(frozen=True)
class State:
    """State of a training after some generations.

    Attributes:
        taste, head: the networks for scores and for stability; the search changes the linear weights of the first
            network.
        search: the distribution from which candidates are drawn.
    """

    taste: Network
    head: Network
    search: Search

    @property
    def update(self) -> int:
        """Number of generations so far."""
        return int(self.search.count)

    @property
    def policy(self) -> Policy:
        """The policy with the weights that are published: the mean of the candidates' distribution."""
        return with_linear(Policy(self.taste, self.head), self.search.mean)

    def save(self, path: Path) -> None:
        """Write the state to a file, completely or not at all."""
        arrays = {**self.taste.arrays("taste"), **self.head.arrays("head"), **self.search.arrays}
        with path.with_suffix(".part").open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        path.with_suffix(".part").replace(path)

    @classmethod
    def load(cls, path: Path) -> State:
        """Read a state from a file."""
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        search = Search(**{name: arrays[name] for name in Search.__dataclass_fields__})
        return cls(Network.of_arrays("taste", arrays), Network.of_arrays("head", arrays), search)


class Training:
    """A training in a folder. It packs orders in several processes."""

    def __init__(self, plan: Plan, out: Path, pool: ProcessPoolExecutor, labeller: Labeller) -> None:
        self.plan, self.out, self._pool, self._labeller = plan, out, pool, labeller

    def run(self, deadline: float, save_every: int) -> State:
        """Run all stages of the training that are not finished."""
        path, plan = self.out / "state.npz", self.plan
        if path.exists():
            state = State.load(path)
            self._cut_curves(state.update)
        else:
            state = self._begun()
            state.save(path)
            self._row(state, [], 0.0)
        while state.update < plan.updates and time.monotonic() < deadline:
            round_ = state.update // plan.relabel
            if 0 < round_ <= plan.rounds and state.update % plan.relabel == 0:
                try:
                    state = replace(state, head=self._head(round_, deadline))
                except TimeoutError:
                    print(f"labels of round {round_ - 1} took too long", flush=True)
                    break
            if round_ < plan.rounds:
                self._labeller.begin(round_, state.policy)
            state = self._updated(state)
            if state.update % save_every == 0:
                state.save(path)
        state.save(path)
        return self._ended(state)

    def _ended(self, state: State) -> State:
        """The final state, whose head is fitted to all labels, including labels that are still being collected."""
        rounds = min(-(-state.update // self.plan.relabel), self.plan.rounds)
        if rounds:
            self._publish(state)
            try:
                state = replace(state, head=self._head(rounds, time.monotonic() + self.plan.patience_s))
            except TimeoutError:
                print("the last labels took too long", flush=True)
        self._publish(state)
        return state

    def _publish(self, state: State) -> None:
        with (self.out / "learned.npz").open("wb") as file:
            state.policy.save(file)

    # ------------------------------------------------------------------ stages

    def _head(self, rounds: int, deadline: float) -> Network:
        """The head, fitted to the labels of the first ``rounds`` rounds."""
        labels = self._labeller.labels(rounds, deadline - time.monotonic())
        # in a process with one thread, so that sums do not depend on the load of the machine
        head, calibration = self._pool.submit(fit, labels, self.plan.seed, self.plan.fit_steps).result()
        (self.out / f"calibration-{rounds - 1}.json").write_text(json.dumps(calibration, indent=1))
        for placements, said in calibration.items():
            brief = {name: figure for name, figure in said.items() if name != "reliability"}
            print(f"head of {rounds} rounds, {placements}: {json.dumps(brief)}", flush=True)
        return head

    def _begun(self) -> State:
        """The first state: a policy that acts like the rule, with a head that estimates that all placements stand."""
        row_blocks = list(self._pool.map(partial(spread, seed=self.plan.seed), range(self.plan.measured), chunksize=1))
        taste = self._pool.submit(scaled, np.concatenate(row_blocks)).result()
        return State(taste, believing(), Search.fresh(taste.linear, self.plan.sigma))

    def _updated(self, state: State) -> State:
        plan, begin = self.plan, time.monotonic()
        rng = stream(plan.seed, STREAM, state.update)
        candidates = state.search.drawn(plan.candidates, rng)
        tasks = [(plan.seed, state.update, number) for number in range(plan.orders)]
        one = partial(outcomes, policy=state.policy, candidates=candidates)
        outcomes_by_order = list(self._pool.map(one, tasks, chunksize=1))
        worth = np.array([policy_worth(of_one) for of_one in zip(*outcomes_by_order, strict=True)])
        after = replace(state, search=state.search.told(candidates, worth))
        self._row(after, [outcome for order in outcomes_by_order for outcome in order], time.monotonic() - begin)
        return after

    # ------------------------------------------------------------------ curves

    def _row(self, state: State, outcomes: list[Outcome], seconds: float) -> None:
        row: dict[str, Any] = {"update": state.update, "seconds": round(seconds, 3)}
        if outcomes:
            row |= {f"played_{name}": value for name, value in _means(outcomes).items()}
        row["sigma"] = float(state.search.sigma)
        if state.update % self.plan.validate == 0:
            for look_ahead in (1, 5):
                one = partial(validated, policy=state.policy, look_ahead=look_ahead)
                means = _means(list(self._pool.map(one, range(self.plan.orders), chunksize=1)))
                row |= {f"valid_{look_ahead}_{name}": value for name, value in means.items()}
        if self.plan.judge and state.update % self.plan.judge == 0:
            row |= {f"judged_{name}": value for name, value in judged(state.policy, self.plan.engine).items()}
        with (self.out / "curves.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")
        if state.update % self.plan.validate == 0:
            print(json.dumps({name: round(value, 4) for name, value in row.items()}), flush=True)

    def _cut_curves(self, update: int) -> None:
        """Remove the rows of updates that will be made again."""
        path = self.out / "curves.jsonl"
        rows = path.read_text().splitlines() if path.exists() else []
        path.write_text("".join(f"{row}\n" for row in rows if json.loads(row)["update"] <= update))


def _means(outcomes: list[Outcome]) -> dict[str, float]:
    return {
        name: float(np.mean([getattr(outcome, name) for outcome in outcomes])) for name in Outcome.__dataclass_fields__
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--minutes", type=float, default=25.0, help="from the start; stage 3 stops then")
    parser.add_argument("--workers", type=int, default=cpu_threads())
    parser.add_argument("--save-every", type=int, default=10, help="updates")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--updates", type=int, default=1000)
    parser.add_argument("--orders", type=int, default=48, help="of a generation")
    parser.add_argument("--candidates", type=int, default=24, help="of a generation")
    parser.add_argument("--rounds", type=int, default=3, help="of labels; 0: none")
    parser.add_argument("--relabel", type=int, default=30, help="updates before a round's labels are used")
    parser.add_argument("--label-pallets", type=int, default=512, help="side by side, of a round of labels")
    parser.add_argument("--label-steps", type=int, default=50, help="boxes placed on each pallet")
    parser.add_argument("--measured", type=int, default=48, help="orders that set the scales of features")
    parser.add_argument("--fit-steps", type=int, default=400)
    parser.add_argument("--validate", type=int, default=20, help="updates between two validations")
    parser.add_argument("--judge", type=int, default=0, help="updates between two judgements by physics; 0: none")
    parser.add_argument("--patience-s", type=float, default=600.0, help="for labels that are still coming at the end")
    parser.add_argument("--sigma", type=float, default=0.12, help="deviation of the first candidates' weights")
    arguments = vars(parser.parse_args())
    deadline = time.monotonic() + 60 * arguments["minutes"]
    out, begin = arguments["out"], time.monotonic()
    plan = Plan(**{name: arguments[name] for name in Plan.__dataclass_fields__})
    if out.exists() and any(out.iterdir()) and not arguments["resume"]:
        raise SystemExit(f"{out} is not empty; go on with --resume")
    out.mkdir(parents=True, exist_ok=True)
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    how = {"seed": plan.seed, "pallets": plan.label_pallets, "steps": plan.label_steps, "engine": plan.engine}
    labeller = Labeller(out, how)
    with process_pool(arguments["workers"]) as pool:
        state = Training(plan, out, pool, labeller).run(deadline, arguments["save_every"])
    labeller.close()
    result = {**asdict(plan), "updates": state.update, "seconds": round(time.monotonic() - begin, 1)}
    (out / "result.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
