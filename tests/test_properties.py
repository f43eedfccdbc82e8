"""Any arguments to any public name: a result, a result code or one sentence (see benchmarks/hostile.py)."""

from hypothesis import given, HealthCheck, Phase, settings

from benchmarks import hostile
from benchmarks.hostile_calls.valid_calls import calls
from benchmarks.hostile_calls.values import names_for

# Of these, something that takes long is made before they are looked at: the drawn examples try them.
DEAR = {("design", "folder"), ("optimise_fingertip", "interval"), ("pinch_object", "force")}
DEAR |= {("loci", "grasp"), ("link_clearance", "grasp"), ("pinch_balance", "grasp")}
# A run that did not end early has no friction to go on with; a function without cases does not take any.
OF_NO_USE = {("resume", "friction"), ("ClosedLoop", "cases"), ("Firmness", "cases")}


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


def test_every_argument_is_named_where_it_is_an_object_of_no_use(tmp_path, monkeypatch):
    """One after the other, all others as they should be."""
    monkeypatch.chdir(tmp_path)
    seen, unnamed = [], []
    for call in calls().values():
        for parameter, argument in call.arguments.items():
            tried = "thing" in names_for(argument.kind) and "thing" not in argument.taken
            if not tried or (call.name, parameter) in DEAR | OF_NO_USE:
                continue
            example = hostile.Example(call.name, ((parameter, "thing"),))
            ended = hostile.outcome(example)
            seen.append((example, ended))
            if not ended.words.startswith(f"argument {parameter}"):
                unnamed.append(f"{example}: {ended.words}")
    assert len(seen) > 600
    assert all(ended.kind == "sentence" for _, ended in seen), hostile.report(seen)
    assert not unnamed, unnamed


def test_every_public_name_has_an_example():
    """`calls` raises where a name or one of its parameters has none."""
    assert len(calls()) > 100


def test_the_judge_knows_offences():
    assert hostile.is_one_sentence("argument radius must be positive, but was -1.0")
    for page in ("argument radius\nmust be positive", "argument radius must be " + 300 * "x", "bad radius"):
        assert not hostile.is_one_sentence(page)
