"""Parquet files that hold rows; the only module that imports pyarrow.

The schema carries the features of Hugging Face's ``datasets``, so that the library and the hub's
viewer show the column of photographs as images.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from benchmark.publishing.columns import Column
from benchmark.publishing.rows import Row
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.storage.files import require_readable

# A file is closed when its pictures reach this size; hubs ask for less than 500 MB.
_SHARD_BYTES: Final = 400 * 10**6
# A viewer reads one group of rows at a time. A group ends at this many bytes of pictures or rows.
_GROUP_BYTES: Final = 32 * 10**6
_GROUP_ROWS: Final = 100


def write_shards(
    folder: Path,
    stem: str,
    columns: Mapping[str, Column],
    rows: Iterable[Row],
    shard_bytes: int = _SHARD_BYTES,
) -> list[Path]:
    """Write rows to ``STEM-00000.parquet`` and so on.

    Args:
        folder: folder of the files; it is created.
        stem: beginning of their names.
        columns: columns of every row.
        rows: consumed one at a time.
        shard_bytes: bytes of pictures after which the next file begins.

    Returns:
        The files in order.

    Raises:
        InputError: pyarrow is not installed.
        OSError: the folder cannot be written.
    """
    parquet = _parquet()
    schema = _schema(columns)
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    with ExitStack() as stack:
        writer: Any = None
        group: list[Row] = []
        group_bytes = written = 0
        for row in rows:
            if writer is None or written >= shard_bytes:
                _flush(writer, group, schema)
                stack.close()
                files.append(folder / f"{stem}-{len(files):05d}.parquet")
                writer = stack.enter_context(
                    parquet.ParquetWriter(files[-1], schema, compression="zstd")
                )
                group_bytes = written = 0
            group.append(row)
            size = _picture_bytes(row)
            group_bytes, written = group_bytes + size, written + size
            if group_bytes >= _GROUP_BYTES or len(group) == _GROUP_ROWS:
                _flush(writer, group, schema)
                group_bytes = 0
        _flush(writer, group, schema)
    return files


def read_shards(files: Sequence[Path], columns: Sequence[str]) -> Iterator[Row]:
    """Yield every row with these columns alone.

    Raises:
        InputError: a file is missing, damaged or lacks a column, or pyarrow is not installed.
    """
    parquet = _parquet()
    for file in files:
        require_readable(file, "shard")
        try:
            with parquet.ParquetFile(file) as opened:
                missing = [name for name in columns if name not in opened.schema_arrow.names]
                if missing:
                    raise InputError(
                        f"shard {file} has no column {missing[0]!r}: publish the scenes again"
                    )
                for batch in opened.iter_batches(_GROUP_ROWS, columns=list(columns)):
                    yield from batch.to_pylist()
        # On damaged bytes, pyarrow raises these errors or errors derived from them.
        except (OSError, RuntimeError, MemoryError, KeyError, UnicodeDecodeError) as error:
            reason = str(error).partition("\n")[0]
            raise InputError(f"shard {file} is damaged: {reason}") from None
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"shard {file} is damaged: {error}") from None


def require_parquet() -> None:
    """Check that Parquet files can be written, before long work.

    Raises:
        InputError: pyarrow is not installed.
    """
    _parquet()


def _parquet() -> Any:
    return import_extra("pyarrow.parquet", "hub", "a published data set")


def _flush(writer: Any, group: list[Row], schema: Any) -> None:
    """Write a group of rows and empty it."""
    if group:
        import pyarrow as pa

        writer.write_table(pa.Table.from_pylist(group, schema=schema))
        group.clear()


def _picture_bytes(row: Row) -> int:
    """Return the bytes of a row's pictures."""
    return sum(len(value["bytes"]) for value in row.values() if isinstance(value, dict))


def _schema(columns: Mapping[str, Column]) -> Any:
    import pyarrow as pa

    features = {name: _feature(column) for name, column in columns.items()}
    return pa.schema(
        [(name, _type(column)) for name, column in columns.items()],
        metadata={"huggingface": json.dumps({"info": {"features": features}})},
    )


def _type(column: Column) -> Any:
    """Return a column's type in Arrow."""
    import pyarrow as pa

    if column.kind == "picture":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    kinds = {
        "text": pa.string(),
        "float": pa.float64(),
        "integer": pa.int32(),
    }
    kind = kinds[column.kind]
    # Parquet has no lists of a fixed length that may be null.
    for _ in column.shape:
        kind = pa.list_(kind)
    return kind


def _feature(column: Column) -> dict[str, Any]:
    """Return a column's feature in the notation of ``datasets``."""
    if column.kind == "picture":
        return {"_type": "Image"}
    kinds = {"text": "string", "float": "float64", "integer": "int32"}
    feature: dict[str, Any] = {"dtype": kinds[column.kind], "_type": "Value"}
    for _ in column.shape:
        # The older name of a list, which every release reads.
        feature = {"feature": feature, "length": -1, "_type": "Sequence"}
    return feature
