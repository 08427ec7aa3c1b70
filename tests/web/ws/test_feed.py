import asyncio
from types import SimpleNamespace

from tactiled.live.hub import Hub
from tactiled.web.ws.feed import Feeds
from tests.conftest import run_apart


def test_the_loop_takes_the_newest_image_of_each_sensor_in_one_turn_and_an_error_of_one_stops_no_other():
    sensors = {name: SimpleNamespace(name=name, hub=Hub()) for name in ("broken", "sound")}
    seen, errors, divisor = [], [], [1]

    async def main():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context["message"]))
        feeds = Feeds(SimpleNamespace(sensors=sensors))
        sound = feeds["sound"]
        with feeds["broken"].listen(lambda: 1 / divisor[0]), sound.listen(lambda: seen.append(sound.image)):
            divisor[0] = 0
            for image in (1, 2, 3):
                for each in sensors.values():
                    each.hub.publish(image)
            await asyncio.sleep(0.01)

    run_apart(main())
    assert seen == [None, 3]
    assert errors == ["stream of broken"]
