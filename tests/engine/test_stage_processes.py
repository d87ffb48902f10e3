"""What the process of a stage is given."""

from pipeline.engine.child import stage_environment


def test_threads_of_a_stage_sleep_while_they_wait_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    assert stage_environment()["OMP_WAIT_POLICY"] == "PASSIVE"
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    assert stage_environment()["OMP_WAIT_POLICY"] == "ACTIVE"
