"""Curves of one or more trainings, as a figure and a table.

    python examples/train_packer/figure.py trained [more …] --out curves.png

Needs matplotlib (extra ``show``). A CSV file with one column for each curve is written beside the figure.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd

PANELS = (
    ("utilisation", ("valid_1_utilisation", "valid_5_utilisation", "played_utilisation")),
    ("volume left out", ("valid_1_left_out", "valid_5_left_out")),
    ("chance that a plan stands, said by the head; judged by physics", ("valid_1_chance", "judged_share")),
    ("entropy of a decision", ("entropy",)),
)


def table(folders: list[Path]) -> pd.DataFrame:
    """The rows of the curves of all trainings, in one table."""
    parts = [pd.read_json(folder / "curves.jsonl", lines=True).assign(training=folder.name) for folder in folders]
    return pd.concat(parts, ignore_index=True)


def main() -> None:
    import matplotlib.pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    curves = table(arguments.folders)
    curves.to_csv(arguments.out.with_suffix(".csv"), index=False)
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.5), sharex=True, layout="constrained")
    for panel, (title, columns) in zip(axes.flat, PANELS, strict=True):
        panel.set_title(title, fontsize=9)
        for name, rows in curves.groupby("training"):
            for column in columns:
                if column in rows and rows[column].notna().any():
                    known = rows[rows[column].notna()]
                    panel.plot(known["update"], known[column], label=f"{name}: {column}", linewidth=1)
        panel.legend(fontsize=6)
        panel.grid(alpha=0.3)
    for panel in axes[-1]:
        panel.set_xlabel("updates")
    figure.savefig(arguments.out, dpi=130)


if __name__ == "__main__":
    main()
