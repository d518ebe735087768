"""Disc cams against circles, textbook formulae, differences, and followers that are laid on the profile one by one."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from optlink.linkage import cams
from optlink.linkage.cams import Arm, DiscCam, Face, Roller, Slide
from optlink.linkage.jet import Jet

TURN = 2.0 * math.pi
ANGLES = np.linspace(0.0, TURN, 360, endpoint=False)
FOLLOWERS = {
    "roller": (Slide(), Roller(0.008)),
    "knife edge": (Slide(), Roller()),
    "offset roller": (Slide(offset=0.009), Roller(0.008)),
    "roller to the left and below": (Slide(direction=3.5, offset=-0.009), Roller(0.008)),
    "flat face": (Slide(), Face()),
    "offset flat face": (Slide(direction=-1.2, offset=0.007), Face()),
    "roller on an arm": (Arm((0.09, 0.02), 0.08), Roller(0.01)),
    "roller on an arm that lifts clockwise": (Arm((-0.05, 0.07), 0.07, 0.006, side=-1), Roller(0.01)),
    "flat arm": (Arm((0.09, 0.02), offset=0.004), Face()),
    "flat arm that lifts clockwise": (Arm((-0.05, 0.09), 0.02, -0.005, side=-1), Face()),
}


def turned(points, angles):
    """Points (n,) turned counter-clockwise by angles."""
    return points * np.exp(1j * angles)


def parts(jet):
    return tuple(np.broadcast_to(part, ANGLES.shape) if np.ndim(part) == 0 else part for part in jet.parts)


# --- circles -----------------------------------------------------------------------------------------------------------------

RADIUS, OUT, AHEAD = 0.04, 0.012, 0.7  # of a circle, whose centre is `OUT` from the pivot, at the angle `AHEAD` in its axes


def on_a_circle(guide, contact):
    """Position of a follower on an eccentric circle, by geometry of its own: slide [m] or angle to the line to the pivot."""

    def position(theta):
        x, y = OUT * np.cos(theta + AHEAD), OUT * np.sin(theta + AHEAD)
        if isinstance(guide, Slide):
            c, s = math.cos(guide.direction), math.sin(guide.direction)
            along, right = x * c + y * s, x * s - y * c
            if isinstance(contact, Face):
                return along + RADIUS
            return along + np.sqrt((RADIUS + contact.radius) ** 2 - (guide.offset - right) ** 2)
        px, py = guide.pivot
        dx, dy = x - px, y - py  # from the arm's pivot to the centre
        to_centre = np.arctan2(-px * dy + py * dx, -px * dx - py * dy) * guide.side  # from the line to the cam's pivot
        distance = np.sqrt(dx * dx + dy * dy)
        if isinstance(contact, Face):  # the centre is the radius below the face
            return to_centre + np.arcsin((RADIUS - guide.offset) / distance)
        length, reach = math.hypot(guide.length, guide.offset), RADIUS + contact.radius
        opening = np.arccos((distance * distance + length**2 - reach**2) / (2.0 * length * distance))
        return to_centre + opening - math.atan2(guide.offset, guide.length)

    return position


def least_distance(guide, contact, lowest):
    """Base radius with which a position is the lowest one."""
    if isinstance(guide, Slide):
        return lowest if isinstance(contact, Face) else math.hypot(lowest, guide.offset) - contact.radius
    distance = math.hypot(*guide.pivot)
    if isinstance(contact, Face):
        return distance * math.sin(lowest) + guide.offset
    tip = complex(guide.length, guide.offset) * complex(math.cos(lowest), math.sin(lowest))
    return abs(distance - tip) - contact.radius


def circular(follower):
    """The cam that ought to be the circle."""
    guide, contact = FOLLOWERS[follower]
    position = on_a_circle(guide, contact)
    lowest = float(np.min(position(np.linspace(0.0, TURN, 100_001))))

    def lift(theta):
        return parts(position(Jet(theta, 1.0)) - lowest)

    return DiscCam(lift, guide, contact, least_distance(guide, contact, lowest))


@pytest.mark.parametrize("follower", FOLLOWERS)
def test_the_motion_on_an_eccentric_circle_gives_this_circle(follower):
    """Profile, pitch curve, radii of curvature, normal, and pressure angle."""
    cam = circular(follower)
    touch, centre = cam.at(ANGLES), OUT * np.exp(1j * AHEAD)
    np.testing.assert_allclose(abs(touch.profile - centre), RADIUS, rtol=1e-12)
    np.testing.assert_allclose(touch.radius, RADIUS, rtol=1e-9)
    np.testing.assert_allclose(touch.normal, turned((touch.profile - centre) / RADIUS, ANGLES), atol=1e-12)
    np.testing.assert_allclose(turned(touch.profile, ANGLES), touch.contact, atol=1e-15)
    assert not np.any(touch.undercut)
    if isinstance(cam.contact, Roller):
        np.testing.assert_allclose(abs(touch.pitch - centre), RADIUS + cam.contact.radius, rtol=1e-12)
    assert np.ptp(np.unwrap(np.angle(touch.profile - centre))) > TURN - 0.1  # all of the circle


@pytest.mark.parametrize("follower", [name for name, (_, contact) in FOLLOWERS.items() if isinstance(contact, Roller)])
def test_the_outer_flank_of_a_groove_is_a_circle_too(follower):
    cam = circular(follower)
    touch, centre = cam.at(ANGLES, outer=True), OUT * np.exp(1j * AHEAD)
    np.testing.assert_allclose(abs(touch.profile - centre), RADIUS + 2.0 * cam.contact.radius, rtol=1e-12)
    np.testing.assert_allclose(touch.radius, -(RADIUS + 2.0 * cam.contact.radius), rtol=1e-9)
    np.testing.assert_allclose(touch.normal, -cam.at(ANGLES).normal, atol=1e-15)
    np.testing.assert_allclose(touch.pressure_angle, cam.at(ANGLES).pressure_angle, atol=1e-15)


# --- any law -----------------------------------------------------------------------------------------------------------------


def waves(theta, phase=0.0):
    """A lift between 0 and about 1 with its derivatives: three harmonics."""
    jet = Jet(theta, 1.0) - phase
    return parts(0.55 - 0.4 * np.cos(jet) - 0.1 * np.cos(2.0 * jet + 0.4) - 0.05 * np.cos(3.0 * jet))


def wavy(follower, height=None, phase=0.0, base=0.035):
    guide, contact = FOLLOWERS[follower]
    size = height or (0.011 if isinstance(guide, Slide) else 0.14)
    return DiscCam(lambda theta: tuple(size * part for part in waves(theta, phase)), guide, contact, base)


def stands(cam, angles):
    """Roller centres, or the feet and normals of the faces, in the fixed axes, by their definition."""
    lift, guide = cam.lift(angles)[0], cam.guide
    if isinstance(guide, Slide):
        along = np.exp(1j * guide.direction)
        if isinstance(cam.contact, Face):
            return (cam.base_radius + lift) * along, np.full(lift.shape, along)
        prime = cam.base_radius + cam.contact.radius
        return (math.sqrt(prime**2 - guide.offset**2) + lift - 1j * guide.offset) * along, None
    pivot, side = complex(*guide.pivot), 1j * guide.side
    if isinstance(cam.contact, Face):
        lowest = math.asin((cam.base_radius - guide.offset) / abs(pivot))
    else:
        length, prime = abs(complex(guide.length, guide.offset)), cam.base_radius + cam.contact.radius
        cosine = (abs(pivot) ** 2 + length**2 - prime**2) / (2.0 * abs(pivot) * length)
        lowest = math.acos(cosine) - math.atan2(guide.offset, guide.length)
    along = -pivot / abs(pivot) * np.exp(side * (lowest + lift))
    return pivot + (guide.length + side * guide.offset) * along, side * along


@pytest.mark.parametrize("follower", FOLLOWERS)
def test_every_position_of_the_follower_touches_the_profile_and_cuts_it_nowhere(follower):
    cam, deviation = wavy(follower), 2e-8
    line = cam.polyline(deviation) @ [1.0, 1j]
    closed = np.append(line, line[0])
    for angle, point, normal in zip(ANGLES[::3], *stands(cam, ANGLES[::3]), strict=True) if isinstance(cam.contact, Face) else ():
        heights = np.real((turned(line, angle) - point) * np.conj(normal))
        assert -deviation <= np.max(heights) <= 1e-15
    for angle, point in zip(ANGLES[::3], stands(cam, ANGLES[::3])[0], strict=True) if isinstance(cam.contact, Roller) else ():
        centre, edge = turned(point, -angle), np.diff(closed)
        share = np.clip(np.real((centre - line) * np.conj(edge)) / np.abs(edge) ** 2, 0.0, 1.0)
        assert abs(np.min(np.abs(centre - line - share * edge)) - cam.contact.radius) <= deviation
    area = 0.5 * np.sum(np.imag(np.conj(line) * np.roll(line, -1)))
    assert area > math.pi * cam.base_radius**2  # counter-clockwise round the base circle


@pytest.mark.parametrize("follower", FOLLOWERS)
@pytest.mark.parametrize("outer", [False, True])
def test_curvature_and_advance_are_those_of_the_curve(follower, outer):
    """Derivatives of a smooth periodic curve by its Fourier series."""
    cam = wavy(follower)
    if outer and isinstance(cam.contact, Face):
        return
    angles = np.linspace(0.0, TURN, 1024, endpoint=False)
    touch = cam.at(angles, outer=outer)
    orders = np.fft.fftfreq(1024, 1.0 / 1024)
    first, second = (np.fft.ifft(np.fft.fft(touch.profile) * (1j * orders) ** k) for k in (1, 2))
    np.testing.assert_allclose(np.abs(first), np.abs(touch.advance), rtol=1e-7)
    bend = np.imag(np.conj(first) * second) / np.abs(first) ** 3  # negative for a clockwise bulge
    np.testing.assert_allclose(1.0 / touch.radius, bend if outer else -bend, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("follower", FOLLOWERS)
def test_the_torque_follows_from_virtual_work(follower):
    """A force along the normal does as much work on the follower as the cam receives: per turn of the cam, and by its angle."""
    cam = wavy(follower)
    touch, rate = cam.at(ANGLES), cam.lift(ANGLES)[1]
    if isinstance(cam.guide, Slide):
        work = rate * np.cos(touch.pressure_angle)
    else:
        arm = touch.contact - complex(*cam.guide.pivot)
        work = rate * cam.guide.side * np.imag(np.conj(arm) * touch.normal)
        held = (touch.point if isinstance(cam.contact, Roller) else touch.contact) - complex(*cam.guide.pivot)
        np.testing.assert_allclose(work, rate * np.abs(held) * np.cos(touch.pressure_angle), atol=1e-15)
    np.testing.assert_allclose(touch.lever, work, atol=1e-15)


@given(st.sampled_from(sorted(FOLLOWERS)), st.floats(-10.0, 10.0))
def test_a_law_that_begins_later_turns_the_profile_back(follower, phase):
    early, late = wavy(follower).at(ANGLES - phase), wavy(follower, phase=phase).at(ANGLES)
    np.testing.assert_allclose(late.profile, turned(early.profile, -phase), atol=1e-14)
    np.testing.assert_allclose(late.pressure_angle, early.pressure_angle, atol=1e-9)
    np.testing.assert_allclose(late.radius, early.radius, rtol=1e-6)


@given(st.floats(0.02, 0.1), st.floats(0.001, 0.01))
def test_a_mirrored_arm_gives_the_mirrored_profile(base, size):
    """The arm lifts to the other side, and the cam turns the other way."""

    def lift(theta):
        return tuple(part * size / 0.08 for part in waves(theta))

    def backwards(theta):
        value, first, second = lift(-theta)
        return value, -first, second

    for contact in (Roller(0.01), Face()):
        one = DiscCam(lift, Arm((0.15, 0.03), 0.12, 0.004), contact, base).at(ANGLES)
        other = DiscCam(backwards, Arm((0.15, -0.03), 0.12, 0.004, side=-1), contact, base).at(-ANGLES)
        np.testing.assert_allclose(other.profile, np.conj(one.profile), atol=1e-13)
        np.testing.assert_allclose(other.pressure_angle, -one.pressure_angle, atol=1e-9)


# --- textbook ----------------------------------------------------------------------------------------------------------------


def test_formulae_of_the_textbook():
    """Norton (2009), chapter 7: pressure angle, radius of curvature of the pitch curve and of a flat-faced cam, face width."""
    cam = wavy("offset roller")
    s, v, a = cam.lift(ANGLES)
    touch, prime, offset = cam.at(ANGLES), cam.base_radius + cam.contact.radius, cam.guide.offset
    np.testing.assert_allclose(np.tan(touch.pressure_angle), (v - offset) / (s + math.sqrt(prime**2 - offset**2)), atol=1e-14)
    cam = wavy("roller")
    touch = cam.at(ANGLES)
    pitch = ((prime + s) ** 2 + v * v) ** 1.5 / ((prime + s) ** 2 + 2.0 * v * v - a * (prime + s))
    np.testing.assert_allclose(touch.radius + cam.contact.radius, pitch, rtol=1e-12)
    cam = wavy("flat face")
    touch = cam.at(ANGLES)
    np.testing.assert_allclose(touch.radius, cam.base_radius + s + a, rtol=1e-12)
    np.testing.assert_allclose(touch.along, v, atol=1e-16)
    np.testing.assert_allclose(touch.pressure_angle, 0.0, atol=1e-15)
    dense = cam.lift(np.linspace(0.0, TURN, 200_001))[1]
    np.testing.assert_allclose(cam.extremes(lambda contact: contact.along), (dense.min(), dense.max()), rtol=1e-9)


def test_an_undercut_cam_is_found():
    """A flat face undercuts where base radius, lift and second derivative add up to less than nothing."""
    s, _, a = waves(np.linspace(0.0, TURN, 100_001))
    least = -0.02 * float(np.min(s + a))
    assert not np.any(wavy("flat face", 0.02, base=1.01 * least).at(ANGLES).undercut)
    undercut = wavy("flat face", 0.02, base=0.9 * least)
    assert 0 < np.sum(undercut.at(ANGLES).undercut) < 180
    line = undercut.polyline() @ [1.0, 1j]
    feet, normals = stands(undercut, ANGLES)
    above = np.real(turned(line, ANGLES[:, None]) * np.conj(normals)[:, None]) - np.real(feet * np.conj(normals))[:, None]
    assert np.max(above) > 1e-6  # the curve passes through some faces


def test_a_roller_that_is_too_large_undercuts():
    """Its radius must be less than the least radius of curvature of the pitch curve where that bulges, not where it is hollow."""
    small = wavy("knife edge", 0.03).at(ANGLES).radius
    least = float(np.min(small[small > 0.0]))
    assert np.min(small) < 0.0
    assert float(np.min(np.abs(small))) >= 0.9 * least
    for radius, expected in ((0.98 * least, False), (1.02 * least, True)):
        cam = DiscCam(wavy("roller", 0.03).lift, Slide(), Roller(radius), 0.035 - radius)
        assert np.any(cam.at(ANGLES).undercut) == expected


def test_a_narrow_groove_undercuts_on_its_outer_flank_alone():
    """Where the pitch curve is hollow, the wall of the outer flank bulges."""
    lift = wavy("knife edge", 0.03).lift
    pitch = wavy("knife edge", 0.03).at(ANGLES).radius
    hollow, bulging = float(np.min(-pitch[pitch < 0.0])), float(np.min(pitch[pitch > 0.0]))
    assert hollow > bulging
    flatter = DiscCam(lift, Slide(), Roller(1.02 * hollow), 0.035 - 1.02 * hollow)
    assert np.any(flatter.at(ANGLES, outer=True).undercut)
    assert not np.any(DiscCam(lift, Slide(), Roller(0.98 * hollow), 0.035 - 0.98 * hollow).at(ANGLES, outer=True).undercut)


def test_an_arm_that_is_too_short_for_the_base_circle():
    cam = DiscCam(waves, Arm((0.2, 0.0), 0.05), Roller(0.01), 0.03)
    assert np.all(np.isnan(cam.at(ANGLES).profile))


# --- polyline ----------------------------------------------------------------------------------------------------------------


def with_rests(theta):
    """Harmonic rise in 0.9 rad, rest, fall in 1.4 rad, rest: its second derivative jumps at four angles."""
    turns = np.mod(theta, TURN)
    lift, first, second = np.zeros((3, *turns.shape))
    for begin, length, sign in ((0.5, 0.9, 1.0), (3.0, 1.4, -1.0)):
        w, x = math.pi / length, turns - begin
        moves = (x >= 0.0) & (x < length)
        lift += np.where(moves, 0.5 * (1.0 - sign * np.cos(w * x)), 0.0) + ((sign > 0.0) & (turns >= 1.4) & (turns < 3.0))
        first += np.where(moves, 0.5 * sign * w * np.sin(w * x), 0.0)
        second += np.where(moves, 0.5 * sign * w * w * np.cos(w * x), 0.0)
    return 0.01 * lift, 0.01 * first, 0.01 * second


BREAKS = (0.5, 1.4, 3.0, 4.4)


@pytest.mark.parametrize("follower", ["roller", "offset roller", "flat face"])
@pytest.mark.parametrize("deviation", [1e-5, 1e-6, None])
def test_a_polyline_keeps_to_the_profile(follower, deviation):
    cam = DiscCam(with_rests, *FOLLOWERS[follower], 0.08, BREAKS)
    line = cam.polyline(deviation) @ [1.0, 1j]
    dense = cam.at(np.linspace(0.0, TURN, 7_001)).profile
    edge = np.roll(line, -1) - line
    share = np.clip(np.real((dense[:, None] - line) * np.conj(edge)) / np.abs(edge) ** 2, 0.0, 1.0)
    far = np.max(np.min(np.abs(dense[:, None] - line - share * edge), axis=1))
    assert np.all(edge != 0.0)
    allowed = deviation or cams.DEVIATION * 0.08
    assert 0.1 * allowed < far <= allowed
    expected = TURN * math.sqrt(0.08 / (8.0 * allowed))  # corners of a circle of this size
    assert max(50.0, 0.9 * expected) < len(line) < 4.0 * expected + 100.0


def test_extremes_of_a_law_with_jumps():
    """The radius of a flat-faced cam jumps at the breaks: its least value is that at the end of the rise."""
    cam = DiscCam(with_rests, *FOLLOWERS["flat face"], 0.08, BREAKS)
    least, largest = cam.extremes(lambda contact: contact.radius)
    w = math.pi / 0.9
    assert least == pytest.approx(0.08 + 0.01 - 0.005 * w * w, rel=1e-6)
    assert largest == pytest.approx(0.08 + 0.005 * w * w, rel=1e-6)
