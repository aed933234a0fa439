"""Sentences on the estimators of a run, and on behaviour that its samples may miss."""

from __future__ import annotations

from mic.contact.laws import LAWS
from mic.report.style import percent
from mic.results.outcome import Outcome
from mic.statistics.estimates import SEEN, confidence, rarest_event

__all__ = ["claimed_confidence", "estimator_sentences", "interval_claim", "sample_count"]

FEWEST = 3  # samples that give an interval
FUNCTIONS = {
    "plain": "a constant",
    "linear": "a linear function of the deviations",
    "quadratic": "a quadratic function of the deviations",
    "spline": "a spline of the deviations",
}


def sample_count(outcome: Outcome, law: str) -> str:
    """Number of samples in words: ``50 followed samples and 400 in one step``."""
    improved, samples = outcome.improved(law), len(outcome.sample_numbers(law))
    if improved is None or not improved.estimates.cheap_samples:
        return f"{samples} sample{'s' * (samples != 1)}"
    return f"{samples}{_followed(law)} samples and {improved.estimates.cheap_samples} in one step"


def estimator_sentences(outcome: Outcome) -> list[str]:
    """Estimators of the key characteristics, by law; and whether the required accuracy is reached.

    Laws with the same estimators share a sentence; a law whose estimates are those of the samples alone has none.
    """
    laws: dict[str, list[str]] = {}
    for law in outcome.laws:
        if outcome.improved(law) is not None:
            laws.setdefault(_of_law(outcome, law), []).append(law)
    sentences = [f"{', '.join(named)}: {text}" for text, named in laws.items()]
    accuracy = outcome.model.scene.monte_carlo.accuracy
    if accuracy is not None:
        sentences.append(f"{outcome.uncertainty(accuracy.required).sentence(outcome.record['samples'])}.")
    return sentences


def claimed_confidence(outcome: Outcome) -> str:
    """Smallest share of the intervals of the run that contain the true value, in words."""
    return percent(float(confidence(min((len(outcome.sample_numbers(law)) for law in outcome.laws), default=0))))


def interval_claim(outcome: Outcome, law: str) -> str:
    """State which effects the intervals of the key characteristics cover, and how often."""
    improved, samples = outcome.improved(law), len(outcome.sample_numbers(law))
    if improved is not None and all(yes for key, yes in zip(improved.keys, improved.better) if key[0] == "measurement"):
        return _unseen(outcome, law)
    if samples < FEWEST:
        return f"Fewer than {FEWEST} samples give no intervals."
    share = float(rarest_event(samples))
    assemblies = f"at least {percent(share, 1)} of the assemblies" if share < 1 else "all assemblies"
    return (
        f"Intervals: at least {percent(float(confidence(samples)))} contain the true value if each effect occurs in "
        f"{assemblies}; "
        f"{samples} samples may miss rarer effects."
    )


def _of_law(outcome: Outcome, law: str) -> str:
    improved, count = outcome.improved(law), sample_count(outcome, law)
    assert improved is not None
    by_words: dict[str, list[str]] = {}
    explained: dict[str, float] = {}
    for k, (key, kind) in enumerate(zip(improved.keys, improved.estimates.kind)):
        if key[0] == "measurement":
            words = _words(kind, bool(improved.better[k]))
            by_words.setdefault(words, []).append(key[1])
            share = float(improved.estimates.explained[k])
            explained[words] = min(explained.get(words, 1.0), share) if improved.better[k] else float("nan")
    parts = []
    for words, names in by_words.items():
        who = "all key characteristics" if len(by_words) == 1 and len(names) > 1 else ", ".join(names)
        share = explained[words]
        least = "" if share != share else f", which explain{'s' * (len(names) == 1)} {_at_least(share)} of the variance"
        parts.append(f"{who} {words}{least}")
    text = f"{count}. Mean, 6σ, Cp, Cpk and share outside of {'; '.join(parts)}. " if parts else f"{count}. "
    return text + _unseen(outcome, law)


def _words(kind: str, better: bool) -> str:
    """Describe the estimator of an output, after the output's name."""
    *one_step, function = kind.split(", ")
    if not better:
        return "by the samples alone, because no surrogate is better"
    start = "by the samples in one step, corrected by" if one_step else "by"
    return f"{start} {FUNCTIONS[function]}"


def _at_least(share: float) -> str:
    if share > 0.9999:
        return "more than 99.99 %"
    digits = 2 if share > 0.99 else 0
    return f"at least {percent(int(share * 10 ** (2 + digits)) / 10 ** (2 + digits), digits)}"


def _unseen(outcome: Outcome, law: str) -> str:
    """State which effects the samples may miss."""
    improved, samples = outcome.improved(law), len(outcome.sample_numbers(law))
    cheap = improved.estimates.cheap_samples if improved else 0
    share, beyond = percent(float(rarest_event(samples, SEEN)), 1), ""
    if cheap:
        seen = percent(float(rarest_event(cheap, SEEN)), 1)
        beyond = f"; those in one step show behaviour of {seen} or more, unless the load path causes it"
    among = f"{samples}{_followed(law) * (cheap > 0)} samples"
    return f"Behaviour of fewer than {share} of the assemblies may be unseen in {among}{beyond}."


def _followed(law: str) -> str:
    return " followed" * LAWS[law].followed
