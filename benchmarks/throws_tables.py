"""Tables of docs/throws.md: which throws networks learn from, and how fitness follows from their predictions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean, stdev
from typing import Any

from benchmarks import table_cells
from tasks.design.genes import N_LINKS
from tasks.world import ENVIRONMENTS

_MEASURED = ("predicted", "zero_shot", "adapted")


def errors(results: Mapping[str, Any]) -> str:
    """Tabulate the errors of networks along the paths of robots, by the throws that they learned from."""
    depths = list(results["errors"][0]["error"])
    headings = ["throws", "× steps", "networks", "inputs", "training [s]", *(f"at {depth} m" for depth in depths)]
    lines = [f"| {' | '.join(headings)} |", "|---|--:|---|" + "--:|" * (len(headings) - 3)]
    for row in results["errors"]:
        size = f"{row['n_throws']:,} × {row['n_steps']}"
        throws = f"{row['throws']} †" if row.get("forerunner") else row["throws"]
        cells = [throws, size, row["network"], str(row["inputs"]), f"{row['seconds']:.0f}"]
        cells += [" ".join(f"{error:.2f}" for error in row["error"][depth]) for depth in depths]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def regularisation(results: Mapping[str, Any]) -> str:
    """Tabulate the errors of networks with and without dropout and weight decay: the mean and range over networks."""
    of = results["regularisation"]
    depths = list(of["rows"][0]["errors_of_networks"])
    lines = [f"| dropout | weight decay | {' | '.join(f'at {depth} m' for depth in depths)} |"]
    lines.append(f"|--:|--:|{'--:|' * len(depths)}")
    for row in of["rows"]:
        cells = [f"{row['dropout']:g}", f"{row['weight_decay']:g}"]
        for depth in depths:
            each = [fmean(components) for components in row["errors_of_networks"][depth]]
            cells.append(f"{fmean(each):.3f} ({min(each):.3f} to {max(each):.3f})")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def inference(results: Mapping[str, Any]) -> str:
    """Tabulate what a generation takes with ensembles of several sizes."""
    of = results["inference"]
    n_designs, n_members = of["n_designs"], of["n_members"]
    lines = [
        f"| networks, {n_members} members | inputs | a generation of {n_designs} designs | evaluations of a network |",
        "|---|--:|--:|--:|",
    ]
    n_evaluations = n_members * n_designs * N_LINKS * of["n_steps"]
    for row in of["rows"]:
        network = (row["network"], str(row["inputs"])) if row["inputs"] else ("none, in True Slush", "")
        rate = f"{n_evaluations / row['seconds'] / 1e6:.1f} million/s" if row["inputs"] else ""
        cells = (*network, f"{1e3 * row['seconds']:.0f} ms", rate)
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", f"Measured at commit {of['made_with']['commit'][:7]}."]
    return "\n".join(lines)


def few_throws(results: Mapping[str, Any]) -> str:
    """Tabulate how far robots get with few throws, by the throws and the inputs of the networks."""
    lines = [
        "| throws × steps | of | inputs | predicted | zero-shot | exploiters | adapted "
        "| share of *E*, of each data set | adapted |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for study in _series(results, "few throws", "few throws, magnitudes", "few throws, the paper's scale"):
        inputs = "9" if "magnitudes" in study["series"] else "6"
        for environment, of in (("residual_slush", "paper"), ("designed_throws", "robots")):
            if cells := _of_arm(study, environment):
                lines.append(f"| {' | '.join([study['variant'], of, inputs, *cells])} |")
    return "\n".join([*lines, *_best_of_studies(results)])


def penalty(results: Mapping[str, Any]) -> str:
    """Tabulate how far robots get by the weight of the members' disagreement."""
    return _by_variant(results, "penalty", "k", ("residual_slush", "designed_throws"))


def members(results: Mapping[str, Any]) -> str:
    """Tabulate how far robots get by the number of members."""
    arms = ("residual_slush", "designed_throws", "single_member", "designed_single_member")
    return _by_variant(results, "members", "members", arms)


def rounds(results: Mapping[str, Any]) -> str:
    """Tabulate what throws in rounds are worth beside as many throws at once, by data set."""
    lines = [
        "| throws | in rounds | error: vx, vy, ω | zero-shot [m], of each data set | share of *E* |",
        "|--:|--:|---|--:|--:|",
    ]
    best, groups = fmean(results["in_true_slush"]), [(row["n_throws"], row["n_rounds"]) for row in results["rows"]]
    for group in sorted(set(groups)):
        rows = [row for row, of in zip(results["rows"], groups, strict=True) if of == group]
        error = " ".join(f"{fmean(of):.2f}" for of in zip(*(row["error"] for row in rows), strict=True))
        means = [fmean(row["zero_shot"]) for row in rows]
        each = ", ".join(table_cells.signed(f"{mean:z.1f}") for mean in means)
        share = table_cells.share({"mean": fmean(means)}, {"mean": best})
        lines.append(f"| {group[0]} | {group[1]} | {error} | {each} | {share} |")
    return "\n".join([*lines, *_best(results["in_true_slush"])])


def rules(results: Mapping[str, Any]) -> str:
    """Tabulate how far robots get by the rule that makes a fitness of the members' predictions."""
    lines = [
        "| fitness | evolved in | predicted, μ | zero-shot | exploiters | share of *E*, of each data set | of all |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    best = {"mean": fmean(results["in_true_slush"])}
    for rule, arm in dict.fromkeys((row["rule"], row["arm"]) for row in results["rows"]):
        rows = [row for row in results["rows"] if (row["rule"], row["arm"]) == (rule, arm)]
        predicted, true = ([value for row in rows for value in row[name]] for name in ("predicted", "zero_shot"))
        ks = [f"{row['k']:.1f}" for row in rows if row["k"] is not None]
        means = [table_cells.mean({"mean": fmean(values), "sd": stdev(values)}) for values in (predicted, true)]
        shares = ", ".join(table_cells.share({"mean": fmean(row["zero_shot"])}, best) for row in rows)
        cells = [f"{rule} ({', '.join(ks)})" if ks else rule, ENVIRONMENTS[arm].label, *means]
        cells += [exploiters(zip(predicted, true, strict=True)), shares, table_cells.share({"mean": fmean(true)}, best)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, *_best(results["in_true_slush"])])


def _best(zero_shot: Sequence[float]) -> list[str]:
    """Say below a table what its shares are of."""
    return [
        "",
        f"*E* travels {table_cells.mean({'mean': fmean(zero_shot), 'sd': stdev(zero_shot)})} m (n = {len(zero_shot)}).",
    ]


def _best_of_studies(results: Mapping[str, Any]) -> list[str]:
    """Say the same below a table of studies, which share the robots of *E*."""
    each = {
        tuple(one["zero_shot"] for one in study["champions"] if one["environment"] == "true_slush")
        for study in results["studies"]
    }
    assert len(each) == 1, "studies of a table have the same robots of E"
    return _best(each.pop())


def exploiters(predicted_and_true: Iterable[tuple[float, float | None]]) -> str:
    """Count the champions that travel less than half of their prediction: "1 of 6"."""
    pairs = list(predicted_and_true)
    return f"{sum(true is None or true < predicted / 2 for predicted, true in pairs)} of {len(pairs)}"


def _by_variant(results: Mapping[str, Any], series: str, heading: str, arms: Sequence[str]) -> str:
    lines = [
        f"| {heading} | evolved in | predicted | zero-shot | exploiters | adapted | share of *E*, of each data set "
        "| adapted | R | slope |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for study in _series(results, series):
        fits = {row["learned_from"]: row for row in study["accuracy"] if row["name"] == "mean"}
        for environment in arms:
            if cells := _of_arm(study, environment):
                kind = ENVIRONMENTS[environment]
                fit = fits.get(kind.learns_from, {}) if kind.networks == "all" else {}  # of the members' mean
                shown = [table_cells.figure(fit[name]) if name in fit else "" for name in ("r", "slope")]
                lines.append(f"| {' | '.join([study['variant'], kind.label, *cells, *shown])} |")
    return "\n".join([*lines, *_best_of_studies(results)])


def _series(results: Mapping[str, Any], *names: str) -> list[Mapping[str, Any]]:
    return [study for study in results["studies"] if study["series"] in names]


def _of_arm(study: Mapping[str, Any], environment: str) -> list[str]:
    """Return an arm's displacements and exploiters, its share of *E* zero-shot of each data set, and adapted of all."""
    arms = {arm["environment"]: arm for arm in study["arms"]}
    if environment not in arms:
        return []
    arm, best = arms[environment], arms["true_slush"]["zero_shot"]
    by_data_set: dict[int, list[float]] = {}
    for champion in study["champions"]:
        if champion["environment"] == environment and champion["zero_shot"] is not None:
            by_data_set.setdefault(champion["trial"] % study["n_replicates"], []).append(champion["zero_shot"])
    shares = [table_cells.share({"mean": fmean(values)}, best) for _, values in sorted(by_data_set.items())]
    champions = [one for one in study["champions"] if one["environment"] == environment]
    predicted, zero_shot, adapted = (table_cells.mean(arm.get(name)) for name in _MEASURED)
    return [
        predicted,
        zero_shot,
        exploiters((one["predicted"], one["zero_shot"]) for one in champions),
        adapted,
        ", ".join(shares),
        table_cells.share(arm.get("adapted"), best),
    ]
