"""Shows whether two revisions hold the same code in other places:
``python tools/same_code.py OLD NEW``.

Compares functions, methods, classes without their methods, and statements of the modules of
drivers, identification and rig, all without docstrings, comments and imports. Prints names replaced
in definitions that are the same otherwise (``~``) and definitions without an equal (``-``, ``+``);
ends with 1 where there are any. Not compared: the order in which modules are imported, and what an
attribute of an object stands for.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping

from definitions import Code, Definition, Target

PACKAGES = ("drivers", "identification", "rig")
Pair = tuple[Definition, Definition]
Groups = defaultdict[Hashable, list[Definition]]


def read(revision: str) -> Code:
    """Return the packages at a revision of the repository of the working folder."""
    command = ["git", "archive", revision, *PACKAGES]
    data = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    sources = {}
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        for item in archive:
            if item.name.endswith(".py") and (file := archive.extractfile(item)):
                module = item.name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
                sources[module] = file.read().decode()
    return Code(sources)


def grouped(items: Iterable[Definition], key: Callable[[Definition], Hashable]) -> Groups:
    """Return definitions by what they are compared by."""
    groups: Groups = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return groups


def match(old: Groups, new: Groups) -> tuple[list[Pair], list[Definition], list[Definition]]:
    """Return pairs of the same group, first those of one place, and what is left of both."""
    pairs: list[Pair] = []
    lost: list[Definition] = []
    found: list[Definition] = []
    for key in old.keys() | new.keys():
        stay = {item.place for item in old[key]} & {item.place for item in new[key]}
        before, after = (
            sorted(groups[key], key=lambda item: (item.place not in stay, item.place))
            for groups in (old, new)
        )
        pairs += zip(before, after, strict=False)
        lost += before[len(after) :]
        found += after[len(before) :]
    return pairs, lost, found


def same(old: Code, new: Code) -> tuple[list[Pair], list[Definition], list[Definition]]:
    """Match definitions that are the same and whose names stand for the same definitions."""
    keys = [{item.place: item[1:3] for item in code.definitions} for code in (old, new)]
    both = set(keys[0].values()) & set(keys[1].values())

    def meant(item: Definition, known: Mapping[Target, Hashable]) -> Hashable:
        found = (known.get(target) for target in item.targets)
        return item.tree, item.names, tuple(key if key in both else None for key in found)

    return match(
        grouped(old.definitions, lambda item: meant(item, keys[0])),
        grouped(new.definitions, lambda item: meant(item, keys[1])),
    )


def replaced(old: Definition, new: Definition) -> set[tuple[str, str]]:
    """Return names replaced one for one; none where two became one, or one became two."""
    names = set(zip(old.names, new.names, strict=True))
    one_for_one = len({a for a, _ in names}) == len({b for _, b in names}) == len(names)
    changed = {(a, b) for a, b in names if a != b} if one_for_one else set()
    return {(a.rpartition(":")[2], b.rpartition(":")[2]) for a, b in changed}


def main() -> int:
    """Print the comparison; return 1 where a definition differs."""
    old, new = read(sys.argv[1]), read(sys.argv[2])
    pairs, lost, found = same(old, new)
    moved = sum(a.place[0] != b.place[0] for a, b in pairs)
    names: Counter[tuple[str, str]] = Counter()
    renamed = 0
    for key in (lambda item: (item.names[0], item.tree), lambda item: item.tree):
        near, lost, found = match(grouped(lost, key), grouped(found, key))
        for one, other in near:
            if change := replaced(one, other):
                names.update(change)
                renamed += 1
            else:
                lost.append(one)
                found.append(other)
    print(f"{len(old.definitions)} definitions, {len(pairs)} the same, {moved} of them moved")
    print(f"{renamed} with other names, {len(lost)} without an equal; {len(found)} new")
    for (before, after), times in sorted(names.items()):
        print(f"~ {before} -> {after} ({times})")
    for sign, items in (("-", lost), ("+", found)):
        for item in sorted(items, key=lambda item: item.place):
            print(sign, *item.place)
    return bool(renamed or lost or found)


if __name__ == "__main__":
    sys.exit(main())
