"""Every built-in kind passes the check of its family, which is the contract of a user's model, too."""

import subprocess
import sys
from inspect import signature

import numpy as np
import pytest

import desim.testing
from desim.analysis.metrics import METRICS
from desim.kernel.models.latency_by_link import LATENCIES
from desim.kernel.models.loss import LOSSES, Bernoulli, ByDistance, FourState, GilbertElliott
from desim.pursuit.byzantine.lies import PURSUER_FAULTS
from desim.pursuit.evaders.evasion import STRATEGIES
from desim.pursuit.motion.dynamics import DYNAMICS
from desim.pursuit.motion.flow import FLOWS
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.scenario import PROTOCOLS
from desim.testing import (
    ContractError,
    check_body,
    check_dissemination,
    check_evader,
    check_exporter,
    check_fault,
    check_flow,
    check_latency,
    check_loss,
    check_metric,
    check_protocol,
    check_schedule,
    check_trust,
    decisions,
    links,
    trust,
)
from desim.view.formats.export import EXPORTERS
from protocols.rule import SCHEDULES
from tests.models import NEEDED
from tests.test_overrides import PARAMETERS

CHECKS = [
    (check_latency, LATENCIES),
    (check_loss, LOSSES),
    (check_body, DYNAMICS),
    (check_evader, STRATEGIES),
    (check_schedule, SCHEDULES),
    (check_dissemination, DISSEMINATIONS),
    (check_protocol, PROTOCOLS),
    (check_fault, PURSUER_FAULTS),
    (check_trust, TRUSTS),
    (check_flow, FLOWS),
    (check_exporter, EXPORTERS),
]


def test_all_checks_that_run_a_model_have_one_time_limit():
    checks = [getattr(desim.testing, name) for name in dir(desim.testing) if name.startswith("check_")]
    limits = [
        signature(check).parameters["limit"].default for check in checks if "limit" in signature(check).parameters
    ]
    assert len(limits) > 5
    assert set(limits) == {10.0}


SHARES = {
    "bernoulli": (Bernoulli(p=0.3), 0.3),
    "bursts": (GilbertElliott(share=0.2, loss_good=0.1), 0.2 + 0.8 * 0.1),
    "by_distance": (ByDistance(near=0.4, far=0.4), 0.4),
    "four_state": (FourState(), 0.06948640483383686),
}
CASES = [
    (check, kind, model)
    for check, family in CHECKS
    for kind, model in family.choices().items()
    if check is not check_loss or kind not in SHARES  # those are checked with their share
]
TRIED = {
    "check_protocol": decisions,
    "check_schedule": decisions,
    "check_dissemination": decisions,
    "check_trust": trust,
}
"""By check, the module of its situations."""
DRAWS = {"check_latency": {"draws": 100}, "check_loss": {"draws": 400}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("check", "kind", "model"), CASES, ids=[f"{check.__name__}-{kind}" for check, kind, _ in CASES]
)
def test_a_built_in_kind_passes_the_check_of_its_family(check, kind, model, monkeypatch, request):
    """Each kind meets some of the situations, and each situation several kinds, unless whole products are asked for."""
    if check.__name__ in TRIED and not request.config.option.whole_products:
        module, turn = TRIED[check.__name__], CASES.index((check, kind, model))
        situations = dict(list(module.SITUATIONS.items())[turn % 3 :: 3])
        monkeypatch.setattr(module, "SITUATIONS", situations)
    check(model(**(NEEDED | PARAMETERS).get(model.__name__, {})), **DRAWS.get(check.__name__, {}))


@pytest.mark.parametrize("kind", ["constant", "uniform", "matrix"])
def test_a_built_in_latency_passes_the_check_with_few_draws(kind):
    model = LATENCIES.choices()[kind]
    check_latency(model(**PARAMETERS.get(model.__name__, {})), draws=8)


@pytest.mark.parametrize("kind", ["bernoulli", "four_state"])
def test_a_built_in_loss_passes_the_check_with_few_draws(kind):
    check_loss(LOSSES.choices()[kind](), draws=8)


@pytest.mark.slow
def test_every_built_in_metric_passes_the_check_of_metrics():
    """One at a time would be 90 times the same runs."""
    check_metric(lambda result: sum(bool(metric(result)) for metric in METRICS.values()))


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("name", SHARES)
def test_the_share_of_a_loss_is_compared_with_that_of_the_theory(name, monkeypatch):
    """The control is a share that is 0.05 off.

    Four states: (q + p14) / (1 + q (1 + p32 / p23) + p14) with q = p13 / p31.
    """
    model, share = SHARES[name]
    check_loss(model, share=share)
    monkeypatch.setattr(links._Losses, "check_batches", lambda self, draws: np.zeros((draws, 3)))
    monkeypatch.setattr(links._Losses, "check_draw", lambda *_: None)
    with pytest.raises(ContractError, match=r"of the messages is lost.*expected 0\.\d+ within 5 standard errors"):
        check_loss(model, share=share + 0.05)


@pytest.mark.whole
def test_a_model_is_given_as_an_object_a_class_a_kind_a_table_or_a_name():
    for still in ("still", {"kind": "still"}, "desim.pursuit.evaders.evasion:Still", STRATEGIES.choices()["still"]):
        check_evader(still)


@pytest.mark.whole
def test_a_run_is_the_same_under_every_hash_seed(monkeypatch):
    monkeypatch.setattr(decisions, "SITUATIONS", {})
    check_protocol("local_min", hash_seeds=True, limit=60.0)


@pytest.mark.whole
def test_the_checks_cost_nothing_until_they_are_used_and_need_no_pytest():
    code = "import sys, desim, desim.testing; assert not {'numpy', 'pytest', 'desim.testing.links'} & set(sys.modules)"
    code += "; from desim.testing import *; assert check_latency and 'pytest' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'check_nothing'"):
        _ = desim.testing.check_nothing
