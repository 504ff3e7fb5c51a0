"""Read results files into a table with pandas (pip install pandas).

python examples/07_results_in_pandas.py [RESULTS]    (after 05_compare_two_methods.py)
"""

from pathlib import Path

try:
    import pandas as pd
except ImportError as error:
    raise SystemExit(f"{error}: this example needs pandas (pip install pandas)") from None

import benchmark
import objconnect as oc
from benchmark.results.results_files import BASIN


def main(folder: Path = Path("runs/examples/results")) -> pd.DataFrame:
    # One row for each query of each method. `read_results` checks that the figures in a file
    # follow from its queries.
    rows = []
    for path in sorted(folder.rglob("*.json")):
        if path.name.endswith(BASIN):
            continue
        results = benchmark.read_results(path)
        for query in results.queries:
            row = query.model_dump(include={"name", "condition", "t_err_m", "r_err_deg"})
            rows.append({"method": results.method.name, "start": results.start, **row})
    if not rows:
        raise oc.InputError(f"{folder} holds no results: run 05_compare_two_methods.py first")
    table = pd.DataFrame(rows)

    # A query without a pose has no error: the comparison is false, so it counts as not found.
    table["found"] = (table.t_err_m < 0.5) & (table.r_err_deg < 5)
    print(table.groupby(["start", "method", "condition"]).found.agg(["mean", "size"]))
    print(table.groupby("method").t_err_m.describe())
    return table


if __name__ == "__main__":
    oc.run_script(main)
