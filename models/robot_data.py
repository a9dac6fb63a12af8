"""Numbers of the robots, each with its source; generate.py writes the URDF files from them.

Frames are base-aligned: at the zero pose every link frame has the base's axes. KD is
kroshu/kuka_robot_descriptions @7766e92, KX ros-industrial/kuka_experimental @01ae9a4, AE
ros-industrial/abb_experimental @20b9cf8, UR UniversalRobots/Universal_Robots_ROS2_Description @2221ec0.
Lengths in metres, angles in degrees, masses in kilograms, inertias in kg m2 about the link's centre of mass.
"""

KUKA_AXES = ((0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0))
ABB_AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
UR_AXES = ((0, 0, 1), (0, -1, 0), (0, -1, 0), (0, -1, 0), (0, 0, -1), (0, -1, 0))
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

# The same with A2's link turned upright and shortened, as the zero pose of the IRB 6700 has it.
IRB6700_INERTIA = (
    *KR240_INERTIA[:2],
    (250.56, (-0.001, -0.198, 0.486), (82.88, 82.49, 6.75, -0.17, -0.57, 6.95)),
    *KR240_INERTIA[3:],
)

# UR config/ur10e/physical_parameters.yaml, turned into these frames; the base as its cylinder there.
UR10E_INERTIA = (
    (4.0, (0.0, 0.0, 0.0), (0.006106, 0.006106, 0.01125, 0.0, 0.0, 0.0)),
    (7.369, (0.021, -0.027, 0.0), (0.03408, 0.02156, 0.03529, 0.00425, 2e-05, -8e-05)),
    (13.051, (-0.2327, -0.158, 0.0), (0.02814, 0.76943, 0.77068, 0.01561, 5e-05, -2e-05)),
    (3.989, (-0.33155, -0.068, 0.0), (0.01014, 0.30646, 0.30928, -0.00916, 8e-05, 0.0)),
    (2.1, (0.0, -0.007, -0.018), (0.00296, 0.00222, 0.00258, 1e-05, 0.0, -0.00024)),
    (1.98, (0.0, -0.018, 0.007), (0.00296, 0.00258, 0.00222, 0.0, -1e-05, 0.00024)),
    (0.615, (0.0, 0.026, 0.0), (0.0004, 0.00034, 0.00041, 0.0, 0.0, 0.0)),
)


def heavier(inertia: tuple, masses: tuple) -> tuple:
    """Other masses; the inertias grow with them."""
    return tuple(
        (m, com, tuple(round(v * m / old, 4) for v in tensor))
        for m, (old, com, tensor) in zip(masses, inertia, strict=True)
    )


# Boxes (least corner, greatest corner), or with an axis the cylinders in them, rounded outward to 5 mm that contain KD's collision meshes, hoses too.
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

# The same for AE's meshes of the IRB 6700-235/2.65, links 2 and 4 after the visual ones, whose fork is open;
# link_1 with its balancing cylinder at rest.
IRB6700_BOXES = (
    (
        ((-0.630, -0.365, 0.0), (0.380, 0.365, 0.260)),
        ((-0.485, -0.265, 0.255), (0.260, 0.265, 0.375)),
    ),
    (
        ((-0.415, -0.460, -0.485), (-0.245, 0.155, -0.025)),
        ((-0.255, -0.460, -0.530), (0.005, 0.270, 0.090)),
        ((-0.005, -0.355, -0.550), (0.135, 0.320, 0.155)),
        ((0.125, -0.300, -0.565), (0.500, 0.355, 0.240)),
        ((0.495, -0.145, -0.210), (0.535, 0.090, 0.110)),
        ((-0.765, -0.380, -0.380), (-0.410, -0.005, 0.035)),
    ),
    (
        ((-0.260, -0.340, -0.190), (0.220, -0.115, 0.105)),
        ((-0.165, -0.405, 0.095), (0.240, -0.080, 0.505)),
        ((-0.125, -0.420, 0.495), (0.220, -0.155, 0.720)),
        ((-0.135, -0.425, 0.710), (0.205, -0.185, 0.805)),
        ((-0.140, -0.435, 0.795), (0.190, -0.190, 0.905)),
        ((-0.150, -0.430, 0.895), (0.180, -0.185, 1.005)),
        ((-0.155, -0.410, 0.995), (0.170, -0.235, 1.105)),
        ((-0.155, -0.390, 1.095), (0.160, -0.255, 1.205)),
        ((-0.145, -0.370, 1.195), (0.140, -0.255, 1.295)),
    ),
    (
        ((-0.165, -0.285, -0.175), (0.155, 0.195, -0.070)),
        ((-0.290, -0.285, -0.075), (0.235, 0.350, 0.390)),
    ),
    (
        ((-0.280, -0.085, -0.090), (0.005, 0.085, 0.085)),
        ((-0.005, -0.085, -0.085), (0.155, 0.085, 0.085)),
        ((0.145, -0.110, -0.110), (0.305, 0.105, 0.110)),
        ((0.295, -0.095, -0.095), (0.455, 0.095, 0.095)),
        ((0.445, -0.120, -0.120), (0.695, 0.155, 0.120)),
        ((0.685, -0.210, -0.135), (1.025, 0.050, 0.135)),
        ((1.020, -0.210, -0.143), (1.1825, -0.090, 0.143)),
        ((1.0395, -0.210, -0.143), (1.3255, -0.090, 0.143), "y"),
        ((1.020, -0.095, -0.060), (1.090, -0.070, 0.060)),
        ((0.685, 0.045, -0.125), (1.020, 0.190, 0.125)),
        ((1.015, 0.090, -0.110), (1.1825, 0.190, 0.110)),
        ((1.0395, 0.090, -0.143), (1.3255, 0.190, 0.143), "y"),
    ),
    (((-0.170, -0.100, -0.110), (0.170, 0.100, 0.100)),),
    (((-0.040, -0.100, -0.100), (0.0, 0.100, 0.100)),),
)

# The same for UR's collision meshes of the UR10e, outward to 2 mm.
UR10E_BOXES = (
    (
        ((-0.096, -0.096, 0.0), (0.096, 0.096, 0.060), "z"),
        ((-0.085, -0.085, 0.060), (0.085, 0.085, 0.100), "z"),
    ),
    (((-0.078, -0.096, -0.082), (0.078, 0.078, 0.094)),),
    (
        ((-0.674, -0.250, -0.064), (-0.538, -0.096, 0.064)),
        ((-0.542, -0.268, -0.076), (-0.078, -0.094, 0.076)),
        ((-0.078, -0.270, -0.078), (0.078, -0.094, 0.078), "y"),
    ),
    (
        ((-0.618, -0.108, -0.050), (-0.518, 0.020, 0.050)),
        ((-0.522, -0.106, -0.058), (-0.098, 0.020, 0.058)),
        ((-0.102, -0.102, -0.058), (0.060, 0.020, 0.058)),
    ),
    (
        ((-0.048, -0.048, -0.048), (0.048, 0.070, 0.048), "y"),
        ((-0.048, -0.048, -0.068), (0.048, 0.048, 0.0), "z"),
    ),
    (((-0.048, -0.068, -0.048), (0.048, 0.058, 0.054)),),
    (((-0.056, 0.0, -0.056), (0.056, 0.050, 0.056), "y"),),
)


def kuka(c1: float, a1: float, c2: float, a2: float, c3: float, c4: float) -> tuple:
    """Offsets of A1..A6 and the flange from the OPW parameters, all in base axes."""
    return ((0, 0, c1), (a1, 0, 0), (c2, 0, 0), (0, 0, -a2), (c3, 0, 0), (c4, 0, 0))


def abb(c1: float, a1: float, c2: float, a2: float, c3: float, c4: float) -> tuple:
    """As kuka, for a zero pose with the upper arm upright and the forearm along +x."""
    return ((0, 0, c1), (a1, 0, 0), (0, 0, c2), (0, 0, -a2), (c3, 0, 0), (c4, 0, 0))


def ur(d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> tuple:
    """As kuka, from UR's Denavit-Hartenberg lengths: at the zero pose the arm is stretched along -x."""
    return ((0, 0, d1), (0, 0, 0), (a2, 0, 0), (a3, -d4, 0), (0, 0, -d5), (0, -d6, 0))


FORWARD = "0 1.5707963267948966 0"
SIDEWAYS = "1.5707963267948966 0 0"
"""Roll, pitch and yaw of the flange at the zero pose: its z along +x, or along -y."""

ROBOTS = {
    "kr240": dict(
        title="KUKA KR 240 R2900-2",
        source="kroshu/kuka_robot_descriptions: urdf/kr240_r2900_2_macro.xacro, config/kr240_r2900_2_joint_limits.yaml",
        reach=2.9003, payload=240.0,
        offsets=kuka(0.645, 0.330, 1.350, -0.115, 1.220, 0.240), axes=KUKA_AXES, ranges=KUKA_RANGES,
        velocity=(103, 94, 100, 170, 129, 206), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.508, 0.643, 1.707, 5.061, 5.144, 6.232), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes=KR240_BOXES, adjust={}, inertia=KR240_INERTIA, flange=FORWARD, shape="kuka", opw=dict(
            a1=0.330, a2=-0.115, b=0.0, c1=0.645, c2=1.350, c3=1.220, c4=0.240,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
    "kr240-ultra": dict(
        title="KUKA KR 240 R2900 ultra (composed from its siblings)",
        source="lengths from kroshu/kuka_robot_descriptions kr210_r3100_ultra and ros-industrial/kuka_experimental kr270r2700, kr210r2700extra; limits of the R3100 ultra; "
        "masses of the R2900-2",
        reach=2.8956, payload=240.0,
        offsets=kuka(0.675, 0.350, 1.350, 0.041, 1.200, 0.240), axes=KUKA_AXES,
        ranges=((-185, 185), (-140, -5), (-120, 155), (-350, 350), (-122.5, 122.5), (-350, 350)),
        velocity=(105, 101, 107, 136, 129, 206), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.60, 1.18, 1.25, 5.27, 5.02, 5.14), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes=KR240_BOXES, adjust={}, inertia=KR240_INERTIA, flange=FORWARD, shape="kuka", opw=dict(
            a1=0.350, a2=0.041, b=0.0, c1=0.675, c2=1.350, c3=1.200, c4=0.240,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
    "kr210": dict(
        title="KUKA KR 210 R2700-2",
        source="kroshu/kuka_robot_descriptions: kr210_r2700_2 macro, joint limits and masses; collision boxes of the KR 240 R2900-2, upper arm "
        "shortened; its inertias, in the ratio of the masses",
        reach=2.7010, payload=210.0,
        offsets=kuka(0.645, 0.330, 1.150, -0.115, 1.220, 0.215), axes=KUKA_AXES,
        ranges=((-185, 185), (-140, -5), (-120, 168), (-350, 350), (-125, 125), (-350, 350)),
        velocity=(117, 111, 112, 179, 172, 220), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.98, 1.26, 2.57, 7.04, 1.76, 1.87), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes=KR240_BOXES, adjust={2: -0.200}, flange=FORWARD, shape="kuka",
        inertia=heavier(KR240_INERTIA, (226, 363, 232, 190, 42, 17, 6.6)), opw=dict(
            a1=0.330, a2=-0.115, b=0.0, c1=0.645, c2=1.150, c3=1.220, c4=0.215,
            offsets=(0, -90, 0, 0, 0, 0), flip=(True, False, False, True, False, True)),
    ),
    "irb6700": dict(
        title="ABB IRB 6700-235/2.65",
        source="ros-industrial/abb_experimental: irb6700_235_265_macro: lengths, ranges, speeds, outline; masses, torques and accelerations are "
        "not published: those of the KR 240 R2900-2",
        reach=2.654, payload=235.0,
        offsets=abb(0.780, 0.320, 1.135, -0.200, 1.1825, 0.200), axes=ABB_AXES,
        ranges=((-170, 170), (-65, 85), (-180, 70), (-300, 300), (-130, 130), (-360, 360)),
        velocity=(100, 90, 90, 170, 120, 190), effort=(7290, 9240, 7295, 2324, 2326, 1493),
        rated=(1.508, 0.643, 1.707, 5.061, 5.144, 6.232), light=(2.5, 1.6, 3.5, 7.4, 5.6, 9.0),
        boxes=IRB6700_BOXES, adjust={}, inertia=IRB6700_INERTIA, flange=FORWARD, shape="abb", opw=dict(
            a1=0.320, a2=-0.200, b=0.0, c1=0.780, c2=1.135, c3=1.1825, c4=0.200,
            offsets=(0, 0, -90, 0, 0, 0), flip=(False,) * 6),
    ),
    "ur10e": dict(
        title="Universal Robots UR10e",
        source="UniversalRobots/Universal_Robots_ROS2_Description: config/ur10e/*.yaml; payload from the maker's data sheet; accelerations are not published: "
        "those proposed for MoveIt",
        reach=1.300, payload=12.5,
        offsets=ur(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655), axes=UR_AXES,
        ranges=((-360, 360), (-360, 360), (-180, 180), (-360, 360), (-360, 360), (-360, 360)),
        velocity=(120, 120, 180, 180, 180, 180), effort=(330, 330, 150, 54, 54, 54),
        rated=(5.0,) * 6, light=(5.0,) * 6,
        boxes=UR10E_BOXES, adjust={}, inertia=UR10E_INERTIA, flange=SIDEWAYS, shape="ur", opw=None,
    ),
}  # fmt: skip
