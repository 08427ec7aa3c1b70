import pytest
from websockets.frames import Frame, Opcode
from websockets.streams import StreamReader

from tactiled.web.http.protocols import frame


@pytest.mark.parametrize("size", [0, 125, 126, 65535, 65536])
@pytest.mark.parametrize(("of", "opcode"), [(b"x", Opcode.BINARY), ("x", Opcode.TEXT)])
def test_a_message_is_one_frame_as_a_client_reads_it(size, of, opcode):
    reader = StreamReader()
    reader.feed_data(frame(of * size))
    parsing = Frame.parse(reader.read_exact, mask=False)
    with pytest.raises(StopIteration) as parsed:
        next(parsing)
    assert (parsed.value.value.opcode, parsed.value.value.fin) == (opcode, True)
    assert parsed.value.value.data == b"x" * size
    assert not reader.buffer
