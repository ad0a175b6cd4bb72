"""How good a ranking is: mean average precision, and what chance gives.

Source: C. D. Manning, P. Raghavan and H. Schuetze, Introduction to Information Retrieval, 2008, section 8.4. The
average precision of a query is the mean, over its R relevant items, of the precision at the rank of each; one that is
not ranked counts 0.

Of a random order of N items its mean is, with H_N the harmonic number,

    E[AP] = (1 / N) (H_N + (R - 1) / (N - 1) (N - H_N))

as the item at rank k is relevant with probability R / N, and then (k - 1)(R - 1)/(N - 1) of those before it are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from touchfield.errors import InvalidArgument

__all__ = ["average_precision", "chance_average_precision", "mean_average_precision"]


def average_precision(ranked: Sequence[str], relevant: Collection[str]) -> float:
    """The average precision of one query, 0 to 1.

    Parameters
    ----------
    ranked : sequence of str
        The best first, each once.
    relevant : collection of str
        At least one.

    Raises
    ------
    InvalidArgument
        If nothing is relevant, or a name is ranked twice.
    """
    wanted = frozenset(relevant)
    if not wanted:
        raise InvalidArgument("relevant", "nothing", "at least one name", "Leave such a query out.")
    if len(set(ranked)) != len(ranked):
        raise InvalidArgument("ranked", "a name twice", "each once")
    hits = np.flatnonzero([name in wanted for name in ranked])
    return float((np.arange(1, len(hits) + 1) / (hits + 1)).sum() / len(wanted))


def mean_average_precision(ranks: Mapping[str, Sequence[str]], relevant: Mapping[str, Collection[str]]) -> float:
    """The mean of `average_precision` over queries, 0 to 1.

    Parameters
    ----------
    ranks : mapping of query to ranked names
        The query itself should not be among them.
    relevant : mapping of query to names
        For each query of `ranks`.

    Raises
    ------
    InvalidArgument
        If there is no query, one has nothing relevant, or `relevant` does not tell of one.
    """
    if not ranks:
        raise InvalidArgument("ranks", "no query", "at least one")
    missing = [query for query in ranks if query not in relevant]
    if missing:
        raise InvalidArgument("relevant", f"nothing of the query {missing[0]!r}", "names for each query")
    return float(np.mean([average_precision(names, relevant[query]) for query, names in ranks.items()]))


def chance_average_precision(relevant_count: int, count: int) -> float:
    """The mean average precision of all orders of `count` items of which `relevant_count` are relevant.

    Raises
    ------
    InvalidArgument
        If the counts do not fit.
    """
    if not 1 <= relevant_count <= count:
        raise InvalidArgument(
            "relevant_count", f"{relevant_count} of {count}", "1 or more, and no more than there are"
        )
    if count == 1:
        return 1.0
    harmonic = float((1 / np.arange(1, count + 1)).sum())
    return (harmonic + (relevant_count - 1) / (count - 1) * (count - harmonic)) / count
