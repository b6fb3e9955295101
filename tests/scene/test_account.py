"""What a load says of the folder that it read."""

import json

from gsynopsis.scene.account import Account


def test_an_account_is_one_line_that_adds_up_and_cuts_names() -> None:
    account = Account(photos=8, source="sparse/0", split="rule every8", unread={".heic": 2})
    account = account.without("without a pose", ("a.jpg", "b.jpg", "c.jpg", "d.jpg"))
    account = account.without("not on disk", ("odd\nname.jpg",)).without("damaged", ())
    assert account.with_unread_models("poses_bounds.npy is not read").text() == (
        "8 of 13 photos used, poses of sparse/0; "
        "4 without a pose (a.jpg, b.jpg, c.jpg and 1 more); 1 not on disk (odd\\nname.jpg); "
        "not looked at: 2 .heic (convert photos to JPEG or PNG, HEIC by heif-convert or on the "
        "phone itself); poses_bounds.npy is not read; held out by rule every8; masks: none"
    )


def test_the_json_form_has_all_names() -> None:
    names = tuple(f"{number}.jpg" for number in range(5))
    account = Account(photos=1).without("not on disk", names[:2]).without("not on disk", names[2:])
    document = json.loads(json.dumps(account.document()))
    assert document["left_out"] == {"not on disk": list(names)}
    assert document["photos"] == 1 and document["masks"] == "none"
