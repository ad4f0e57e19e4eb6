import pytest

from oviduct import UnexpectedAnswer
from oviduct._sse import Message, Parser

STREAM = (
    '\ufeff: connected\n\nid: 1\nevent: status\ndata: {"a":\ndata: 1}\n\n'
    "data:\r\ndata: two\r\nid\r\n\r\nevent: progress\rdata: \u00b5m\rid: 7\r\r"
    "id: cursor\n\nretry: 5\nevent: nothing\n\ndata: x\nid: a\0b\n\ndata: cut off"
).encode()
MESSAGES = [
    Message("status", '{"a":\n1}', "1"),
    Message("message", "\ntwo", ""),
    Message("progress", "\u00b5m", "7"),
    Message("message", "x", "cursor"),
]


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 1000])
def test_chunks_of_any_size_give_the_same_events(size):
    parser = Parser()
    chunks = [STREAM[at : at + size] for at in range(0, len(STREAM), size)]
    assert [message for chunk in chunks for message in parser.feed(chunk)] == MESSAGES
    assert parser.last_id == "cursor"


def test_every_split_in_two_gives_the_same_events():
    for at in range(len(STREAM)):
        parser = Parser()
        assert parser.feed(STREAM[:at]) + parser.feed(STREAM[at:]) == MESSAGES, at


def test_an_id_without_an_event_counts_and_an_unfinished_event_does_not():
    parser = Parser("old")
    assert parser.feed(b"data: 1\n\n") == [Message("message", "1", "old")]
    assert parser.feed(b"id: new\ndata: 2\n") == []
    assert parser.last_id == "old"
    assert parser.feed(b"\n") == [Message("message", "2", "new")]
    assert parser.last_id == "new"


def test_data_that_is_no_json_is_an_error():
    with pytest.raises(UnexpectedAnswer):
        Message("status", "{", None).json()
