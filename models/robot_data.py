"""Numbers of the robots, each with its source; generate.py writes the URDF files from them.

Frames are base-aligned: at the zero pose every link frame has the base's axes. KD is
kroshu/kuka_robot_descriptions @7766e92, KX ros-industrial/kuka_experimental @01ae9a4, AE
ros-industrial/abb_experimental @20b9cf8, UR UniversalRobots/Universal_Robots_ROS2_Description @2221ec0.
Lengths in metres, angles in degrees, masses in kilograms, inertias in kg m2 about the link's centre of mass.
"""

KUKA_AXES = ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0))
ABB_AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
KUKA_RANGES = ((-185, 185), (-140, -5), (-120, 168), (-350, 350), (-122.5, 122.5), (-350, 350))

# mass, centre of mass, (Ixx, Iyy, Izz, Ixy, Ixz, Iyz); KD macro kr240_r2900_2, turned into these frames
KR240_INERTIA = (
    (225.96, (-0.059, 0.002, 0.203), (9.03, 12.82, 14.28, 0.18, -0.27, 0.01)),
    (367.37, (0.028, -0.011, -0.104), (14.50, 33.02, 31.78, -4.38, -1.95, 0.21)),
    (250.56, (0.578, -0.198, 0.001), (6.75, 82.49, 82.88, 6.95, 0.57, 0.17)),
    (191.53, (0.173, -0.038, 0.075), (3.64, 21.49, 21.89, -1.12, -0.96, -0.53)),
    (47.94, (1.048, 0.030, 0.0), (0.246, 1.571, 1.640, -0.248, 0.0, 0.0)),
    (23.69, (0.062, 0.042, 0.0), (0.249, 0.291, 0.348, 0.070, 0.0, 0.0)),
    (12.25, (-0.045, 0.0, 0.0), (0.048, 0.037, 0.037, 0.0, 0.0, 0.0)),
)

# Boxes (least corner, greatest corner) rounded outward to 5 mm that contain KD's collision meshes, hoses too.
KR240_BOXES = (
    (
        ((-0.535, -0.380, 0.0), (0.380, 0.380, 0.170)),
        ((-0.580, -0.280, 0.165), (0.250, 0.285, 0.265)),
        ((-0.500, -0.205, 0.260), (0.080, 0.215, 0.350)),
        ((-0.755, 0.075, 0.015), (-0.535, 0.140, 0.170)),
    ),
    (
        ((-0.325, -0.310, -0.420), (0.435, 0.270, 0.125)),
        ((-0.345, -0.510, -0.315), (0.395, -0.305, 0.060)),
        ((-0.525, -0.310, -0.295), (-0.320, 0.170, 0.115)),
        ((-0.310, -0.185, 0.120), (0.435, 0.155, 0.185)),
        ((0.430, -0.110, -0.225), (0.520, 0.160, 0.150)),
    ),
    (
        ((-0.200, -0.400, -0.215), (0.805, 0.020, 0.230)),
        ((0.800, -0.400, -0.200), (1.520, -0.035, 0.215)),
        ((-0.065, -0.505, -0.115), (1.415, -0.395, 0.115)),
        ((-0.080, -0.340, 0.225), (0.610, -0.090, 0.275)),
    ),
    (
        ((-0.445, -0.100, -0.140), (0.625, 0.170, 0.430)),
        ((-0.420, 0.165, -0.100), (0.550, 0.280, 0.375)),
        ((-0.190, -0.505, -0.085), (0.515, -0.220, 0.175)),
        ((-0.360, -0.225, -0.140), (0.625, -0.095, 0.245)),
        ((0.620, -0.195, -0.045), (0.880, 0.160, 0.245)),
        ((-0.365, 0.275, 0.150), (0.130, 0.355, 0.315)),
    ),
    (
        ((0.685, -0.135, -0.135), (1.090, 0.135, 0.135)),
        ((1.085, -0.080, -0.095), (1.315, 0.085, 0.095)),
    ),
    (
        ((-0.125, -0.045, -0.120), (0.215, 0.190, 0.125)),
        ((-0.090, -0.130, -0.100), (0.215, -0.040, 0.100)),
    ),
    (((-0.040, -0.100, -0.100), (0.0, 0.100, 0.100)),),
)


def kuka(c1: float, a1: float, c2: float, a2: float, c3: float, c4: float) -> tuple:
    """Offsets of A1..A6 and the flange from the OPW parameters, all in base axes."""
    return ((0, 0, c1), (a1, 0, 0), (c2, 0, 0), (0, 0, -a2), (c3, 0, 0), (c4, 0, 0))


def abb(c1: float, a1: float, c2: float, a2: float, c3: float, c4: float) -> tuple:
    """As kuka, for a zero pose with the upper arm upright and the forearm along +x."""
    return ((0, 0, c1), (a1, 0, 0), (0, 0, c2), (0, 0, -a2), (c3, 0, 0), (c4, 0, 0))


ROBOTS = {
    "kr240": dict(
        title="KUKA KR 240 R2900-2",
        source="KD urdf/kr240_r2900_2_macro.xacro, config/kr240_r2900_2_joint_limits.yaml",
        reach=2.9003, payload=240.0,
        offsets=kuka(0.645, 0.330, 1.350, -0.115, 1.220, 0.240), axes=KUKA_AXES, ranges=KUKA_RANGES,
        velocity=(103, 94, 100, 170, 129, 206), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.508, 0.643, 1.707, 5.061, 5.144, 6.232), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes="kr240", adjust={}, scale=(1.0, 1.0), opw=dict(
            a1=0.330, a2=-0.115, b=0.0, c1=0.645, c2=1.350, c3=1.220, c4=0.240,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
    "kr240-ultra": dict(
        title="KUKA KR 240 R2900 ultra (composed from its siblings)",
        source="lengths from KD kr210_r3100_ultra and KX kr270r2700, kr210r2700extra; limits of the R3100 ultra; "
        "masses of the R2900-2",
        reach=2.8956, payload=240.0,
        offsets=kuka(0.675, 0.350, 1.350, 0.041, 1.200, 0.240), axes=KUKA_AXES,
        ranges=((-185, 185), (-140, -5), (-120, 155), (-350, 350), (-122.5, 122.5), (-350, 350)),
        velocity=(105, 101, 107, 136, 129, 206), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.60, 1.18, 1.25, 5.27, 5.02, 5.14), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes="kr240", adjust={}, scale=(1.0, 1.0), opw=dict(
            a1=0.350, a2=0.041, b=0.0, c1=0.675, c2=1.350, c3=1.200, c4=0.240,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
    "kr210": dict(
        title="KUKA KR 210 R2700-2",
        source="KD kr210_r2700_2 macro and joint limits; collision boxes of the KR 240 R2900-2, upper arm shortened",
        reach=2.7010, payload=210.0,
        offsets=kuka(0.645, 0.330, 1.150, -0.115, 1.220, 0.215), axes=KUKA_AXES,
        ranges=((-185, 185), (-140, -5), (-120, 168), (-350, 350), (-125, 125), (-350, 350)),
        velocity=(117, 111, 112, 179, 172, 220), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.98, 1.26, 2.57, 7.04, 1.76, 1.87), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes="kr240", adjust={2: -0.200}, scale=(1.0, 1.0), opw=dict(
            a1=0.330, a2=-0.115, b=0.0, c1=0.645, c2=1.150, c3=1.220, c4=0.215,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
}  # fmt: skip
