"""Kinds of arguments of commands, and the faults of each kind."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from tests.robustness.misuse.faults import (
    ABSENT,
    BOMB,
    FORMATS,
    HARMLESS_TEXT,
    LONG,
    NO_FILE,
    NO_FOLDER,
    NUMBERS,
    Faults,
    Spoil,
)

HUGE = str(10**20)
UNDECODED = "\udcff"
"""A byte of a name that is not UTF-8."""
NO_FILES = ("missing", "dangling_link", "cyclic_link", "socket", "fifo", "folder", "endless")
OPTION = "the option"
"""Stands for the names of the option itself."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        words: given instead of the right ones; None gives these.
        at: what is spoiled in the tree.
        spoil: how.
        says: what the error names, one of these; empty: anything.
        fine: a person would expect that the command works.
    """

    words: tuple[str, ...] | None = None
    at: str = ""
    spoil: Spoil | None = None
    says: tuple[str, ...] = ()
    fine: bool = False


@dataclass(frozen=True)
class Argument:
    """A parameter of a command.

    Attributes:
        given: words in a run without fault; None leaves it out.
        faults: by name.
        reads: paths in the tree that it names.
        writes: patterns of what is written because of it.
        output: it names what is written, and is none of what is read.
        kept: it is of use to the next run, also after one that failed.
    """

    given: tuple[str, ...] | None
    faults: Mapping[str, Fault] = field(default_factory=dict)
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    output: bool = False
    kept: bool = False

    def left_out(self) -> Argument:
        """The same, given only where it is wrong."""
        return replace(self, given=None)

    def fine(self, *patterns: str) -> Argument:
        """The same, with some faults that are none for this command."""
        changed = {name: replace(self.faults[name], fine=True) for name in self._like(patterns)}
        return replace(self, faults={**self.faults, **changed})

    def but(self, *patterns: str) -> Argument:
        """The same without some faults."""
        left_out = self._like(patterns)
        return replace(self, faults={k: v for k, v in self.faults.items() if k not in left_out})

    def only(self, *patterns: str) -> Argument:
        """The same with no faults but some."""
        return replace(self, faults={name: self.faults[name] for name in self._like(patterns)})

    def beside_inputs(self) -> Argument:
        """The same, which may be what is read, too."""
        return replace(self, output=False)

    def sound(self) -> Argument:
        """The same with nothing wrong."""
        return replace(self, faults={})

    def given_as(self, word: str) -> Argument:
        """The same in other words."""
        return replace(self, given=(word,))

    def _like(self, patterns: Iterable[str]) -> list[str]:
        found = [n for n in self.faults if any(fnmatchcase(n, p) for p in patterns)]
        assert found, f"no fault is called {patterns}"
        return found

    def also(self, **faults: Fault) -> Argument:
        """The same with more that can be wrong."""
        return replace(self, faults={**self.faults, **faults})


FLAG = Argument(None)


def values(given: str | None, *wrong: str) -> Argument:
    """A word, and words that are none of its kind."""
    faults = {_name(word): Fault((word,), says=_tell(word)) for word in wrong}
    return Argument(None if given is None else (given,), faults)


def integer(given: str | None, *allowed: str) -> Argument:
    """A whole number; ``allowed`` are those that others would find strange."""
    wrong = ["nan", "inf", "-1", "0", "1.5", "1e308", "", "many", f"-{10**19}", HUGE]
    return values(given, *(word for word in wrong if word not in allowed))


def real(given: str | None, *allowed: str) -> Argument:
    """A number."""
    wrong = ["nan", "inf", "-inf", "-1", "0", "1e308", "1e999", "", "much", "1,5"]
    return values(given, *(word for word in wrong if word not in allowed))


def choice(given: str | None, *wrong: str) -> Argument:
    """One of some words."""
    return values(given, "", "magic", "a\nb", "\x1b[31mred", LONG, "../up", *wrong)


def file(path: str, form: str) -> Argument:
    """A file to be read."""
    return Argument((path,), {**_words(path, "/dev/zero"), **_parts(path, form)}, reads=(path,))


def part(path: str, form: str, optional: bool = False) -> dict[str, Fault]:
    """A file in a folder that is read; it need not be there when it is ``optional``."""
    faults = _parts(path, form)
    if optional:
        faults["missing"] = replace(faults["missing"], fine=True)
    return {f"{Path(path).name}:{name}": fault for name, fault in faults.items()}


def folder(path: str, *parts: dict[str, Fault]) -> Argument:
    """A folder to be read, with files in it."""
    whole = {name: _spoil(path, spoil) for name, spoil in NO_FOLDER.items()}
    inner = {name: fault for each in parts for name, fault in each.items()}
    return Argument((path,), {**_words(path, "/dev/null"), **whole, **inner}, reads=(path,))


def out_folder(path: str, *writes: str) -> Argument:
    """A folder to be written, which is not there yet."""
    stands: Faults = {
        **{name: spoil for name, spoil in ABSENT.items() if name != "missing"},
        "file": lambda at: at.write_text("mine\n"),
    }
    return _output(path, stands, *(f"{path}/{pattern}" for pattern in writes), path)


def out_file(path: str, *writes: str) -> Argument:
    """A file to be written, which is not there yet."""
    stands: Faults = {
        **{name: spoil for name, spoil in ABSENT.items() if name != "missing"},
        "folder": lambda at: at.mkdir(),
        "link_to_mine": lambda at: at.symlink_to("mine/notes.txt"),
    }
    return _output(path, stands, path, *writes)


def cache(path: str = "cache") -> Argument:
    """A folder where methods keep what they build."""
    return replace(out_folder(path, "*"), kept=True)


def _output(path: str, stands: Faults, *writes: str) -> Argument:
    faults = {name: _spoil(path, spoil) for name, spoil in stands.items()}
    faults |= _words(path, "/dev/null")
    faults["nowhere"] = Fault((f"/proc/{path}",), says=(path, "/proc"))
    del faults["empty_word"]
    faults["not_utf8_name"] = replace(faults["not_utf8_name"], fine=True)
    return Argument((path,), faults, writes=writes, output=True)


def _words(path: str, device: str) -> dict[str, Fault]:
    """Names of which none can be read as what is meant, nor be written."""
    return {
        "empty_word": Fault(("",)),
        "device": Fault((device,), says=(device,)),
        "under_a_file": Fault((f"mine/notes.txt/{path}",), says=("notes.txt",)),
        "long_name": Fault((LONG,), says=("nnn",)),
        "nul_in_name": Fault((f"{path}\0.txt",), says=(path, "null byte")),
        "not_utf8_name": Fault((add_to_name(path, UNDECODED),), says=(Path(path).stem,)),
    }


def add_to_name(path: str, more: str) -> str:
    """A path whose last name has more before its ending."""
    plain = PurePosixPath(path)
    return str(plain.with_name(f"{plain.stem}{more}{plain.suffix}"))


def _parts(path: str, form: str) -> dict[str, Fault]:
    spoils = {**NO_FILE, **FORMATS[form]}
    faults = {name: _spoil(path, spoil) for name, spoil in spoils.items()}
    if form in ("csv", "words"):
        harmless = {n: replace(_spoil(path, s), fine=True) for n, s in HARMLESS_TEXT.items()}
        faults |= harmless
    return faults


def _spoil(path: str, spoil: Spoil) -> Fault:
    return Fault(at=path, spoil=spoil, says=(*Path(path).parts[-2:], "nowhere"))


def _tell(word: str) -> tuple[str, ...]:
    """What a message repeats of a word: all of it, or one side of its equals sign; else it names
    the option."""
    key, _, value = word.partition("=")
    said = (word, key, value, value.replace("\0", "\\x00"))
    return (*(part for part in said if part and part.isprintable()), OPTION)


def _name(word: str) -> str:
    """A word in the name of a test."""
    if len(word) > 24:
        word = f"{word[:20]}-{len(word)}"
    plain = "".join(c if c.isalnum() or c in "-+.=:," else "_" for c in word)
    return plain or "empty"


METHOD = values("sift", "", "magic", "SIFT", "../sift", "sift\n", LONG)
SETTINGS = values(
    None,
    *("ratio", "=1", "", "colour=red", "ratio=[", "ratio=high", "ratio=.nan", "ratio=-1"),
    *("ratio=2001-99-99", "ratio=!!python/object/apply:os.getcwd []", "max_features=99999999999"),
    *("max_error_px=.inf", "max_features=1.5", f"ratio={'[' * 1000}", f"ratio={BOMB}"),
)


def start(given: str | None, pairs: str) -> Argument:
    """What a method is told."""
    told = values(
        given,
        *(
            "",
            "magic",
            "prior ",
            "Prior",
            "error=",
            "error=3m",
            "error=nanm,5deg",
            "error=1.2.3m,5deg",
        ),
        *("error=3m,500deg", "error=-3m,5deg", f"error={'9' * 400}m,5deg", "retrieval=0"),
        *("retrieval=-1", "retrieval=many", f"retrieval={10**20}", "pairs=", "pairs=nowhere.txt"),
        *("pairs=/dev/zero", f"pairs={LONG}", "pairs=mine/notes.txt/x", "pairs=mine", "pairs=a\0b"),
    )
    listed = {
        f"pairs:{name}": replace(fault, words=(f"pairs={pairs}",))
        for name, fault in _parts(pairs, "words").items()
        if name not in NUMBERS and name not in ("twice", "nul")
    }
    nothing = Fault(("pairs=",), says=("pair list",))
    return told.also(**{**listed, "pairs=": nothing})


CAMERA = values(
    None,
    *("", "PINHOLE", "PINHOLE 96 64", "PINHOLE 96 64 80 80 48", "PINHOLE 96 64 80 80 48 32 1"),
    *("MAGIC 96 64 80 48 32", "PINHOLE -96 64 80 80 48 32", "PINHOLE 0 0 80 80 48 32"),
    *("PINHOLE 96 64 nan 80 48 32", "PINHOLE 96 64 inf 80 48 32", "PINHOLE 96 64 0 0 48 32"),
    *("PINHOLE 96 64 -80 80 48 32", "PINHOLE 1e308 64 80 80 48 32", "PINHOLE 96 64 a b c d"),
    *(f"PINHOLE {10**20} {10**20} 80 80 48 32",),
)
CLUSTER = values(None, "", "magic", "host", "host:port", "local:", ":6379", "a b:1", "h:1/x")
DEVICE = values("cpu", "", "magic", "cuda:999", "cuda:")
SEED = integer("3", "0", HUGE)
