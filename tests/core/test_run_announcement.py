from __future__ import annotations

import pytest

from nmt_core.messages.run_announcement import BagState, RunAnnouncement


def test_both_texts_come_back_as_they_went() -> None:
    run = RunAnnouncement("a1", "run-7", {"levels": [0.1, 0.2]})
    assert RunAnnouncement.from_json(run.to_json()) == run
    bag = BagState("/data/bag-2", "open", 7, "", "a1")
    assert BagState.from_json(bag.to_json()) == bag


@pytest.mark.parametrize("text", ["", "[]", "{", '{"goal": 3}', '{"goal": "a", "plan": []}', "null"])
def test_what_is_no_announcement_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - any of its kinds
        RunAnnouncement.from_json(text)


@pytest.mark.parametrize("text", ["", "{}", '{"path": "a"}', '{"path": 1, "state": "open"}', '{"state": "open"}'])
def test_what_is_no_state_of_a_bag_is_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - any of its kinds
        BagState.from_json(text)
