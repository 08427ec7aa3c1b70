"""The commented configuration that `tactiled init` writes."""

EXAMPLE = """\
# tactiled configuration. Units stand in the keys: mm, MPa, kPa, s.

[server]
host = "127.0.0.1"          # loopback only; any other address needs control_token
port = 8000
# read_token = "…"          # 16 characters or more: a client shows it to see images
# control_token = "…"       # and this one to change anything as well
# tls_certificate = "/etc/tactiled/cert.pem"
# tls_key = "/etc/tactiled/key.pem"
# foxglove = 8765           # for Foxglove's apps on this machine; asks for no token
# xela = 5000               # for clients of XELA's server; asks for no token
# xela_host = "127.0.0.1"   # where: another address lets other machines see those sensors
# recordings = "/var/lib/tactiled"  # folder that clients may record the buses into
recordings_leave_mb = 1000  # of their disk that they leave free; 0: no bound
# state = "/var/lib/tactiled/state.json"  # what clients want kept over a restart
history_s = 5.0             # of images kept for clients that ask for a window
history_mb = 64             # and no more memory than this for all sensors
control_per_minute = 600    # changes, and as many costly answers, that one client may ask for; 0: no bound
streams_per_client = 64     # live streams that one client may have open; 0: no bound
streams = 256               # and all clients together

# One table a CAN bus. `interface` and `channel` are python-can's, and so is any further key:
#   socketcan (can0), slcan (/dev/ttyUSB0), pcan (PCAN_USBBUS1), kvaser (0), udp_multicast, virtual, ...
[bus.can0]
interface = "socketcan"
channel = "can0"
fd = true

# One table a tactile array.
[sensor.palm]
bus = "can0"
method = "auto"             # auto, or one method for every frame
refine = 1                  # surface cells along each side of a taxel: 2 doubles the restored resolution
stale_after_s = 0.5         # an image older than this is served as stale

# What the array says on the bus: "packed" (this project's layout), a skin's own ("icub", ...), or "dbc": what a
# DBC file describes (file = "skin.dbc", taxels = "Row{row}.T{row}_{column}").
[sensor.palm.codec]
name = "packed"
array_id = 0                # CAN id = base_id + array_id
base_id = 0x500
bits = 12                   # a taxel, 8 to 16
fd = true                   # CAN FD messages of 64 bytes; false: classic, 8 bytes

[sensor.palm.array]
rows = 32
columns = 32
pitch_mm = 1.0
aperture_mm = 0.8           # side of a taxel's sensitive square (diameter if aperture = "round")
aperture = "square"

# The rubber over the taxels; several layers: [[sensor.palm.cover]], top to bottom.
[sensor.palm.cover]
thickness_mm = 1.2
young_mpa = 0.6
poisson = 0.48

# What carries the taxels, down to rigid ground; leave it out if that is rigid itself.
[sensor.palm.substrate]
thickness_mm = 1.0
young_mpa = 980.0
poisson = 0.3

[sensor.palm.kernel]
model = "fem"               # "fem": finite elements; "layered": the exact answer for flat layers
accuracy = 1e-3             # of the cover's gain

# pressure = (counts - no_load) * kpa_per_count; negative if counts fall as pressure rises.
[sensor.palm.calibration]
kpa_per_count = 0.05
no_load = 80
saturation = 4095           # counts from which a taxel is at its ceiling
# noise_kpa = 0.1           # standard deviation of one taxel; measured from the first frames if left out
# dead = [17, 301]          # taxels that do not work, by index: row * columns + column
# shear_n_per_count = 6e-4  # of a 3-axis skin: N along it for one count, for clients of XELA's server
"""

SHEAR = """\
# A 3-axis skin: one XELA uSkin module of 4 x 6 taxels. The calibration is made up: tare, and measure your own.

[bus.can0]
interface = "socketcan"
channel = "can0"

[sensor.skin]
bus = "can0"
method = "auto"

[sensor.skin.codec]
name = "xela"

[sensor.skin.array]
rows = 4
columns = 6
pitch_mm = 4.0

[sensor.skin.cover]
thickness_mm = 2.0
young_mpa = 0.3
poisson = 0.45

[sensor.skin.calibration]
kpa_per_count = 0.02
no_load = 36000
shear_n_per_count = 0.0006
"""

GRASP = """\
# Five fingertips of an iCub hand, as the recordings in tactiled/recordings/icub have them: every finger is one
# triangle of twelve taxels. Pressure was never calibrated, so one count is shown as one kPa.

[bus.can0]
interface = "socketcan"
channel = "can0"

[sensor.hand]
bus = "can0"
method = "auto"

[sensor.hand.codec]
name = "icub"
board = 14
triangles = [0, 1, 2, 3, 4]
thermal_pads = false

[sensor.hand.array]
aperture_mm = 3.6
aperture = "round"

[sensor.hand.cover]
thickness_mm = 2.0
young_mpa = 0.3
poisson = 0.45

[sensor.hand.calibration]
no_load = 245
"""
