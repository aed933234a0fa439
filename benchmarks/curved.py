"""What the curved triangle leaves on curved sheets, beside the flat one: the table of docs/curved_triangle.md.

python benchmarks/curved.py        # some two minutes
"""

from __future__ import annotations

from types import SimpleNamespace

from verification.curved_sheets.study import measure, table


def main():
    alone = SimpleNamespace(map=lambda task, items: [task(item) for item in items])
    found = table(measure(SimpleNamespace(quick=False, team=alone)))
    print(f"| {' | '.join(name.removesuffix(', %') for name in found.columns)} |")
    print("| --- " * len(found.columns) + "|")
    for _, row in found.iterrows():
        print(f"| {row.iloc[0]} | {' | '.join(f'{value:.2f} %' for value in row.iloc[1:])} |".replace("-", "−"))


if __name__ == "__main__":
    main()
