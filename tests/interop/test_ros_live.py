"""ROS 2 live: keys, tokens and attachments as the sources of rmw_zenoh have them."""

import re
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh import ext

from tactiled.build import sensor_plan
from tactiled.config import Server, Zenoh, parse
from tactiled.config.example import SHEAR
from tactiled.contacts.detection import DetectedContact
from tactiled.contacts.regions import Region
from tactiled.interop.zenoh.session import open_session
from tactiled.messages.ros import Topics
from tactiled.messages.ros_types import Types
from tactiled.units import nanoseconds
from tests.conftest import BUSY_S, CONFIG, pressed, until
from tests.interop.zenoh_kit import TOKEN, published
from tests.process import free_port

IMAGE = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"  # of Jazzy, as that of Trigger
SERVICE = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
RESTORED, RAW = (f"7/palm/{name}/sensor_msgs::msg::dds_::Image_/{IMAGE}" for name in ("restored", "raw"))
TARE = f"7/palm/tare/std_srvs::srv::dds_::Trigger_/{SERVICE}"
JAZZY = get_typestore(Stores.ROS2_JAZZY)
JAZZY.register(get_types_from_msg("bool success\nstring message", "std_srvs/msg/Response"))
QOS = "(?P<reliability>2?):(?P<durability>1?):,(?P<depth>[0-9]+):,:,:,,"  # all else is rmw_zenoh's default
TYPE = "(?P<type>[a-z0-9_]+::(msg|srv)::dds_::[A-Za-z]+_)/(?P<hash>RIHS01_[0-9a-f]{64})"
TOPIC = f"/(?P<topic>%[a-z_%]+)/{TYPE}/{QOS}"
GRAMMAR = re.compile(
    rf"@ros2_lv/7/(?P<zid>[0-9a-f]+)/(?P<nid>\d+)/(?P<id>\d+)/(?P<entity>NN|MP|SS)/%/%/palm({TOPIC})?"
)


@pytest.fixture
def network(rig):
    """Publishes the rig in domain 7 by way of a router; gives another session of the network."""
    with ExitStack() as stack:

        def start(server=Server()):  # noqa: B008
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            links = f'listen: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}'
            stack.enter_context(zenoh.open(zenoh.Config.from_json5(f'{{mode: "router", {links}}}')))
            session = stack.enter_context(open_session(Zenoh(mode="client", connect=[endpoint])))
            stack.enter_context(published(rig, endpoint, server, mode="client", ros_domain=7))
            until(lambda: any(each["topic"] == "%diagnostics" for each in tokens(session)))
            return session

        yield start


def tokens(session):
    replies = session.liveliness().get("@ros2_lv/7/**", timeout=BUSY_S)
    return [GRAMMAR.fullmatch(str(each.ok.key_expr)) for each in replies]


def subscribed(rig, session, key):
    """Messages of a key; the publisher knows of the subscriber, as one message has come."""
    samples = []
    session.declare_subscriber(key, samples.append)
    until(lambda: rig.show(pressed()) and samples)
    return samples


def trigger(session):
    """Call the service; gives success and message."""
    request = struct.pack("<qqB16s", 41, time.time_ns(), 16, b"0123456789abcdef")
    (reply,) = session.get(TARE, payload=b"\0\1\0\0\0", attachment=request, timeout=BUSY_S)
    number, _, length, gid = struct.unpack("<qqB16s", reply.ok.attachment.to_bytes())
    assert (number, length, gid, str(reply.ok.key_expr)) == (41, 16, b"0123456789abcdef", TARE)
    response = JAZZY.deserialize_cdr(reply.ok.payload.to_bytes(), "std_srvs/msg/Response")
    return response.success, response.message


def by_stamp(samples):
    """Messages by their stamp, ns."""
    messages = [JAZZY.deserialize_cdr(each.payload.to_bytes(), "sensor_msgs/msg/Image") for each in [*samples]]
    return {each.header.stamp.sec * 10**9 + each.header.stamp.nanosec: each for each in messages}


def pass_on(rig, *topics):
    """Show frames until one comes on all of these topics, as a busy link may drop some; gives its image."""
    while True:
        image = rig.show(pressed(rig.sequence % 6))
        with suppress(AssertionError):
            until(lambda: all(nanoseconds(image.time) in by_stamp(each) for each in topics), 5.0)  # noqa: B023
            return image


def test_a_subscriber_gets_exact_images_with_the_stamp_of_their_frame_numbered_by_one_publisher(rig, network):
    session = network()
    raw, restored = (subscribed(rig, session, key) for key in (RAW, RESTORED))
    for _ in range(3):
        image = pass_on(rig, raw, restored)
        for samples, values in ((raw, image.raw), (restored, image.restored)):
            message = by_stamp(samples)[nanoseconds(image.time)]
            np.testing.assert_array_equal(message.data.view("<f4").reshape(message.height, message.width), values)
            assert (message.header.frame_id, message.encoding) == ("palm", "32FC1")
    heads = [struct.unpack("<qqB16s", each.attachment.to_bytes()) for each in raw]
    numbers, times, lengths, ids = zip(*heads, strict=True)
    assert np.diff(numbers).min() == 1
    assert (np.diff([*times, time.time_ns()]) > 0).all()
    assert times[0] > time.time_ns() - 10 * BUSY_S * 1e9
    assert {*lengths} == {16}
    assert len({*ids} - {bytes(16)}) == 1


def test_what_the_regions_hold_is_published_to_whom_subscribes(rig, network):
    heel = Region(shape="rectangle", points_mm=[[2.5, 2.5], [4.5, 4.5]])
    rig.sensor.regions.put("heel", heel)
    data = subscribed(rig, network(), "7/palm/regions/**")[-1].payload.to_bytes()
    message = Types().store.deserialize_cdr(data, "tactiled_msgs/msg/TactileRegions")
    image = rig.sensor.hub.latest()
    ((name, force, peak),) = [(each.name, each.force, each.peak) for each in message.regions]
    inside = image.restored[3:5, 3:5]
    assert (name, message.pressure_unit, message.force_unit) == ("heel", "kPa", "N")
    assert (force, peak) == pytest.approx((1e-3 * inside.sum(), inside.max()), rel=1e-5)


def test_tokens_are_as_rmw_zenoh_parses_them_and_end_with_the_publisher(rig, network):
    session = network()
    entities = tokens(session)
    assert all(entities)
    assert len({each["id"] for each in entities}) == len(entities)
    (node,) = (each for each in entities if each["entity"] == "NN")
    assert (node["id"], node["topic"]) == (node["nid"], None)
    assert len({each["zid"] for each in entities} - {str(session.zid())}) == 1
    topics = {each["topic"]: each for each in entities if each["entity"] == "MP"}
    assert {each["nid"] for each in topics.values()} == {node["nid"]}
    assert topics["%palm%raw"].group("hash", "reliability", "durability") == (IMAGE, "2", "")
    assert topics["%palm%restored"].group("hash", "reliability", "durability") == (IMAGE, "", "")
    assert topics["%palm%layout"].group("durability", "depth") == ("1", "1")
    assert topics["%diagnostics"]["type"] == "diagnostic_msgs::msg::dds_::DiagnosticArray_"
    (service,) = (each for each in entities if each["entity"] == "SS")
    assert service.group("topic", "type", "hash") == ("%palm%tare", TARE.split("/")[3], SERVICE)
    rig.service.sensors = {}
    until(lambda: not tokens(session))


def test_who_comes_late_gets_what_is_transient_local(rig, network):
    session, samples = network(), []
    image = rig.show(pressed())
    subscribed(rig, session, RAW)
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    subscriber = ext.declare_advanced_subscriber(
        session, "7/palm/layout/**", samples.append, history=history, subscriber_detection=True
    )
    until(lambda: samples)
    layout = Types().store.deserialize_cdr(samples[0].payload.to_bytes(), "tactiled_msgs/msg/TactileLayout")
    assert len(layout.x_mm) == image.raw.size
    subscriber.undeclare()


def test_nothing_is_encoded_that_nobody_subscribes_to(rig, network, monkeypatch):
    kinds, cdr = [], Types.cdr
    monkeypatch.setattr(Types, "cdr", lambda self, kind, fields: kinds.append(kind) or cdr(self, kind, fields))
    subscribed(rig, network(), RAW)
    assert set(kinds) == {"tactiled_msgs/msg/TactileLayout", "sensor_msgs/msg/Image"}
    assert kinds.count("tactiled_msgs/msg/TactileLayout") == 1


def test_the_service_tares_and_answers_when_it_is_done_and_why_it_is_not(rig, network):
    session, none, load = network(), pressed(force=0), pressed()
    assert "a tare needs frames" in trigger(session)[1]
    rig.stale_after(BUSY_S)
    answers = []
    with ThreadPoolExecutor(1) as other:
        for counts in (none, load):
            rig.show(none)
            answer = other.submit(trigger, session)
            while not answer.done():
                rig.show(counts)
            answers.append((*answer.result(), rig.sensor.pipeline.tares.done))
    (_, reason, _) = answers[1]
    assert "contact of" in reason
    assert answers == [(True, "tare complete", 1), (False, reason, 1)]


def test_the_service_is_refused_where_a_change_needs_a_claim(network):
    session = network(Server(control_token=TOKEN))
    success, message = trigger(session)
    assert not success
    assert "server.control_token" in message
    for attachment in (None, b"0" * 32):
        (refusal,) = session.get(TARE, attachment=attachment, timeout=BUSY_S)
        assert f"an attachment of {len(attachment or b'')} bytes" in refusal.err.payload.to_string()


def test_a_wrench_has_the_force_along_the_skin_of_the_contact_that_drags():
    contacts = tuple(DetectedContact(n, 1.0, y, 0.5, 4.0, 10.0, 0.8, 0.6, 0.0) for n, y in enumerate((1.0, 6.0)))
    traction = np.zeros((2, 8, 8), np.float32)
    traction[0, 1, 1], traction[1, 6, 2] = 30.0, -20.0  # kPa on 1 mm2
    image = SimpleNamespace(time=1.5, traction=traction)
    topics = Topics(sensor_plan("palm", parse(CONFIG.format(channel="none")).sensor["palm"]))
    got = [
        topics.types.store.deserialize_cdr(bytes(cdr), "geometry_msgs/msg/WrenchStamped").wrench
        for _, cdr in topics.messages(image, contacts, {}, {"wrench"})
    ]
    forces = [[each.force.x, each.force.y, each.force.z] for each in got]
    np.testing.assert_allclose(forces, [[0.03, 0, 0.5], [0, -0.02, 0.5]], atol=1e-7)
    np.testing.assert_allclose([each.torque.z for each in got], [-0.03e-3, -0.04e-3], atol=1e-9)
    np.testing.assert_allclose([each.torque.x for each in got], [0.5e-3, 3e-3], atol=1e-7)
    skin = Topics(sensor_plan("skin", parse(SHEAR).sensor["skin"]))
    ((topic, cdr),) = skin.messages(image, (), {}, {"traction"})
    picture = skin.types.store.deserialize_cdr(bytes(cdr), "sensor_msgs/msg/Image")
    assert (topic, picture.encoding) == ("traction", "32FC2")
    np.testing.assert_array_equal(picture.data.view("<f4").reshape(8, 8, 2), np.moveaxis(traction, 0, -1))
