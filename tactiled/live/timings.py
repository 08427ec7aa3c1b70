"""How long the frames of a sensor take, counted in histograms; to count a time costs 0.25 µs and no lock."""

from bisect import bisect_left

from tactiled.frames import Image

BOUNDS_S = (*(round(step * 10.0**power, 6) for power in range(-5, 0) for step in (1, 2, 5)), 1.0)  # 10 µs to 1 s
STAGES = ("assemble", "wait", "calibrate", "restore", "check", "publish")
PLACES = ("publish", "send")  # where the age of a frame is counted


class Histogram:
    """How many times fell below each bound of BOUNDS_S; one thread adds, any thread reads."""

    __slots__ = ("counts", "sum_s")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)  # in (bound before, bound]; the last: above all
        self.sum_s = 0.0

    def count(self, seconds: float) -> None:
        """Count one time."""
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.sum_s += seconds


class Timings:
    """The histograms of one sensor."""

    def __init__(self) -> None:
        self.stages = {stage: Histogram() for stage in STAGES}
        self.methods: dict[str, Histogram] = {}  # of restoring alone, by the method that ran
        self.ages = {place: Histogram() for place in PLACES}  # of a frame, since its last message came

    def note(self, image: Image, published: float) -> None:
        """Count an image that was published at `published` (s); for the thread that restores."""
        if image.times is None:
            return
        times = (*image.times[1:], published)
        for histogram, before, after in zip(self.stages.values(), times, times[1:], strict=False):
            histogram.count(after - before)
        if image.method not in self.methods:
            self.methods[image.method] = Histogram()
        self.methods[image.method].count(image.times.restored - image.times.calibrated)
        self.ages["publish"].count(published - image.times.last_message)

    def add_send(self, image: Image, time: float) -> None:
        """Count an image that a client was sent at `time` (s); for the event loop."""
        if image.times is not None:
            self.ages["send"].count(time - image.times.last_message)
