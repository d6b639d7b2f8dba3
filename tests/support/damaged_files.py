"""Loads thousands of damaged files: each may cost at most one line, two seconds of CPU time and a gigabyte of memory.

For 50,000 damaged files in two processes::

    PYTHONPATH=.:tests python -m support.damaged_files --count 50000

Valid files of each kind are damaged at random (bytes flipped, cut, doubled, spliced; tokens replaced by huge numbers,
NaN, deep nesting, escapes, odd letters) and then loaded. Everything that should not happen is listed with the random
seed that reproduces it: tracebacks, lines that are long or hold control characters, slow files, and files that take
much memory.
"""

from __future__ import annotations

import argparse
import faulthandler
import gzip
import multiprocessing
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from petmjx.common.errors import InputError
from support.sound_files import KINDS

SLOW_S = 2.0
FAT_BYTES = 1 << 30
LONGEST_LINE = 6000
"""Largest number of characters of an error line: a path of 4,096 characters, and the error."""

# Kinds of damage.

TOKENS = (
    b"1e308",
    b"-1e308",
    b"1e-308",
    b"5e-324",
    b"0",
    b"-0.0",
    b"-1",
    b"NaN",
    b"nan",
    b"Infinity",
    b"-inf",
    b"1e999999",
    b"9" * 19,
    b"9" * 400,
    b"9" * 5000,
    b"0x" + b"f" * 5000,
    b"1" * 400 + b".5",
    b"0." + b"0" * 400 + b"1",
    b"1_0",
    b"007",
    b"null",
    b"true",
    b"false",
    b'""',
    b'"a"',
    b"[]",
    b"{}",
    b"[[]]",
    b'{"a": 1}',
    b"{a = 1}",
    b"1979-05-27T07:32:00Z",
    b"[" * 5000,
    b"[" * 5000 + b"]" * 5000,
    b'{"a":' * 3000,
    b'{"a": [{' * 300,
    b"{a=" * 2000,
    b"a." * 2000 + b"b = 1",
    b"[a" + b".a" * 500 + b"]",
    b"[[a]]\n" * 200,
    b"(" * 100,
    b'\\"' * 2000,
    b"\\" * 1001,
    b'"' * 999,
    b"'" * 9,
    b'"""',
    b"\\ud800",
    b"\\u0000",
    b"\\u202e",
    b"\\x1b",
    b"\x00",
    b"\x1b[2J",
    b"\x9b",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"\xe2\x80\xae",
    b"\xf0\x9f\x8d\x9e",
    b"\xed\xa0\x80",
    b"\x85",
    b"\r",
    b"\n" * 2000,
    b" " * 4000,
    b"x" * 200_000,
    b'"' + b"x" * 200_000 + b'"',
    b"#",
    b",",
    b",,,,",
    b":",
    b"=",
    b"\t",
    b"../../../dev/zero",
    b"/dev/zero",
    b"/dev/stdin",
    b'"item_sequence": {"1": 1}',
    b"PAR1",
    b"\x1f\x8b\x08\x00",
)
WORDS = b"0123456789.eE+-_\"'aAzZ"


def damaged(data: bytes, rng: random.Random) -> bytes:
    """A copy of the data with one to six random damages."""
    for _ in range(rng.choice([1, 1, 1, 2, 3, 6])):
        data = rng.choice(WAYS)(data or b"\n", rng)
    return data


def _flip(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


def _length(data: bytes, rng: random.Random) -> int:
    return min(rng.choice([1, 1, 2, 5, 30, 300, 2000]), len(data))


def _delete(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + _length(data, rng) :]


def _duplicate(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    times = rng.choice([1, 1, 1, 10, 100])
    return data[:at] + data[at : at + _length(data, rng)] * times + data[at:]


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _splice(data: bytes, rng: random.Random) -> bytes:
    at, source = rng.randrange(len(data)), rng.randrange(len(data))
    length = _length(data, rng)
    return data[:at] + data[source : source + length] + data[at + length :]


def _noise(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(_length(data, rng)) + data[at:]


def _put_token(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.choice(TOKENS) + data[at:]


def _replace_token(data: bytes, rng: random.Random) -> bytes:
    begin = rng.randrange(len(data))
    for _ in range(60):  # look for a place with a word or a number
        if data[begin] in WORDS:
            break
        begin = rng.randrange(len(data))
    end = begin
    while begin > 0 and data[begin - 1] in WORDS:
        begin -= 1
    while end < len(data) and data[end] in WORDS:
        end += 1
    return data[:begin] + rng.choice(TOKENS) + data[end:]


WAYS = (_flip, _delete, _duplicate, _truncate, _splice, _noise, _put_token, *3 * (_replace_token,))


# Results of loading.


@dataclass(frozen=True)
class Finding:
    """A damaged file with a complaint about loading it: too much time or memory, a traceback, or a bad message."""

    kind: str
    seed: int
    what: str

    def __str__(self) -> str:
        return f"{self.kind} --seed {self.seed}: {self.what}"


class _TooSlow(BaseException):
    """Raised when the time limit of a file is over."""


def _flush_timer(_signal: int, _frame: FrameType | None) -> None:
    raise _TooSlow


def mutation(kind: str, seed: int) -> bytes:
    """The damaged file of this kind and random seed."""
    rng = random.Random(f"{kind} {seed}")
    sound = KINDS[kind].sound(rng)
    if not kind.endswith("-gz"):
        return damaged(sound, rng)
    if rng.random() < 0.5:
        return gzip.compress(damaged(sound, rng), 1)
    return damaged(gzip.compress(sound, 1), rng)


def try_one(kind: str, seed: int, folder: Path, memory: bool = True) -> tuple[str, str | None]:
    """Load one damaged file.

    Args:
        memory: whether to check the peak of resident memory, which is that of the whole process.

    Returns:
        "read", "refused" or "failed", and what should not have happened, or None.
    """
    path = folder / KINDS[kind].file
    path.write_bytes(mutation(kind, seed))
    outcome = "read"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    try:
        lines = KINDS[kind].load(path)
    except InputError as error:
        outcome, lines = "refused", [str(error)]
    except _TooSlow:
        return "failed", f"slow: more than {4 * SLOW_S:g} s"
    except Exception as error:
        where = error.__traceback__
        while where is not None and where.tb_next is not None:
            where = where.tb_next
        place = "" if where is None else f" at {where.tb_frame.f_code.co_filename}:{where.tb_lineno}"
        return "failed", f"traceback: {type(error).__name__}: {str(error)[:200]!r}{place}"
    took_s = time.process_time() - begin
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if took_s > SLOW_S:
        return outcome, f"slow: {took_s:.1f} s"
    if memory and (after - before) * 1024 > FAT_BYTES:
        return outcome, f"fat: {(after - before) // 1024} MiB"
    for line in lines:
        if "\n" in line or not line.isprintable():
            return outcome, f"line with control characters: {line[:200]!r}"
        if len(line) > LONGEST_LINE:
            return outcome, f"line of {len(line):,} characters: {line[:200]!r}"
    return outcome, None


def _work(task: tuple[str, range]) -> tuple[Counter[str], list[Finding]]:
    """Load the damaged files of one kind with these seeds, in a process with an alarm and limited memory."""
    kind, seeds = task
    faulthandler.enable()
    signal.signal(signal.SIGALRM, _flush_timer)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + FAT_BYTES, resource.RLIM_INFINITY))
    count: Counter[str] = Counter()
    findings = []
    with tempfile.TemporaryDirectory(prefix="petmjx-damage-") as folder:
        for seed in seeds:
            signal.setitimer(signal.ITIMER_REAL, 4 * SLOW_S)
            try:
                outcome, complaint = try_one(kind, seed, Path(folder))
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            count[f"{kind} {outcome}"] += 1
            if complaint is not None:
                findings.append(Finding(kind, seed, complaint))
    return count, findings


def shares(kinds: list[str], first: int, n: int, size: int = 250) -> Iterator[tuple[str, range]]:
    """Tasks for processes: ranges of random seeds for each kind, with the same number of seeds for all kinds."""
    per_kind = -(-n // len(kinds))
    for begin in range(first, first + per_kind, size):
        for kind in kinds:
            yield kind, range(begin, min(begin + size, first + per_kind))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=50_000, help="mutations in all")
    parser.add_argument("--seed", type=int, default=0, help="first seed of each kind")
    parser.add_argument("--kinds", nargs="*", default=sorted(KINDS), choices=sorted(KINDS))
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    count: Counter[str] = Counter()
    findings: list[Finding] = []
    begin = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        tasks = list(shares(options.kinds, options.seed, options.count))
        for done, new_findings in pool.imap_unordered(_work, tasks):
            count += done
            findings += new_findings
            for finding in new_findings:
                print(finding, flush=True)
    for name, number in sorted(count.items()):
        print(f"{name:<28}{number:>8,}")
    took_s = time.perf_counter() - begin
    print(f"{count.total():,} damaged files in {took_s:.0f} s: {len(findings):,} cost more than a line")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
