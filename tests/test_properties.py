"""Any arguments to any public name: a result, a result code or one sentence (see benchmarks/hostile.py)."""

from hypothesis import given, HealthCheck, Phase, settings

from benchmarks import hostile
from benchmarks.hostile_calls.valid_calls import calls


def test_hostile_arguments_are_answered_or_refused(tmp_path, monkeypatch):
    """200 examples, always the same ones; all offences are told at once."""
    monkeypatch.chdir(tmp_path)
    seen = []

    @settings(
        max_examples=200,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(hostile.examples(refused=True))
    def tried(example):
        seen.append((example, hostile.outcome(example)))

    tried()
    assert len(seen) == 200
    assert all(ended.good for _, ended in seen), hostile.report(seen)


def test_every_public_name_has_an_example():
    """`calls` raises where a name or one of its parameters has none."""
    assert len(calls()) > 100


def test_the_judge_knows_offences():
    assert hostile.is_one_sentence("argument radius must be positive, but was -1.0")
    for page in ("argument radius\nmust be positive", "argument radius must be " + 300 * "x", "bad radius"):
        assert not hostile.is_one_sentence(page)
