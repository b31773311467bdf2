//! Where a picture is taken from: named views, framing of a bounding box, projection to pixels.

use crate::mesh::Vec3;

/// Direction from which a frame is seen; Y is up and the subject faces +Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum View {
    /// From +Z.
    Front,
    /// Turned by 40 degrees towards +X and 5 degrees from above.
    ThreeQuarter,
    /// From +X: the profile.
    Side,
    /// Any direction: `yaw` turns from +Z towards +X, `pitch` raises the camera; degrees.
    Angles {
        /// Turn from +Z towards +X, degrees.
        yaw: f64,
        /// Height above the horizon, degrees.
        pitch: f64,
    },
}

impl View {
    /// Unit vector from the subject to the camera.
    #[must_use]
    pub fn direction(self) -> Vec3 {
        let (yaw, pitch) = match self {
            Self::Front => (0.0, 0.0),
            Self::ThreeQuarter => (40.0, 5.0),
            Self::Side => (90.0, 0.0),
            Self::Angles { yaw, pitch } => (yaw, pitch),
        };
        let (yaw, pitch) = (f64::to_radians(yaw), f64::to_radians(pitch));
        Vec3::new(yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos())
    }

    /// What a caption calls it.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Front => "front".into(),
            Self::ThreeQuarter => "three-quarter".into(),
            Self::Side => "side".into(),
            Self::Angles { yaw, pitch } => format!("yaw {yaw:.0}, pitch {pitch:.0}"),
        }
    }
}

/// An axis-aligned box that a camera shows in full. Panels that share a frame share scale and position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Middle of the box.
    pub centre: Vec3,
    /// Half its side lengths, positive.
    pub half: Vec3,
}

impl Frame {
    /// The box of `points`, robust to outliers: on each axis from the 1st to the 99th percentile, widened by up to 15 % of
    /// that to include the extremes. Non-finite points do not count; without points, the unit box.
    #[must_use]
    pub fn of(points: &[Vec3]) -> Self {
        let mut frame = Self { centre: Vec3::zeros(), half: Vec3::repeat(1.0) };
        let finite: Vec<&Vec3> = points.iter().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        if finite.is_empty() {
            return frame;
        }
        for axis in 0..3 {
            let mut c: Vec<f64> = finite.iter().map(|p| p[axis]).collect();
            c.sort_unstable_by(f64::total_cmp);
            let last = c.len() - 1;
            let (p1, p99) = (c[last / 100], c[last - last / 100]);
            let slack = 0.15 * (p99 - p1);
            let (low, high) = (c[0].max(p1 - slack), c[last].min(p99 + slack));
            frame.centre[axis] = 0.5 * low + 0.5 * high;
            frame.half[axis] = 0.5 * high - 0.5 * low;
        }
        let least = (frame.half.max() * 1e-3).max(1e-9);
        frame.half = frame.half.map(|h| h.max(least));
        frame
    }

    /// The smallest box that holds both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        let low = (self.centre - self.half).inf(&(other.centre - other.half));
        let high = (self.centre + self.half).sup(&(other.centre + other.half));
        Self { centre: (low + high) * 0.5, half: (high - low) * 0.5 }
    }

    /// This place at the scale of `other`: for subjects in different coordinates that are to be compared by size.
    #[must_use]
    pub fn at_scale_of(self, other: Self) -> Self {
        Self { centre: self.centre, half: other.half }
    }

    /// The frame with every side multiplied by `factor`.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { centre: self.centre, half: self.half * factor }
    }
}

/// How depth maps to size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Central projection with this full vertical angle of view, degrees.
    Perspective {
        /// Full vertical angle, degrees.
        vertical_fov: f64,
    },
    /// Parallel projection; the image is this high, millimetres.
    Orthographic {
        /// Height of the image in the scene, millimetres.
        height: f64,
    },
}

/// A camera: position, orthonormal axes and projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    eye: Vec3,
    right: Vec3,
    up: Vec3,
    back: Vec3,
    projection: Projection,
}

/// Why a camera cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the camera cannot be set up: {0}")]
pub struct CameraError(pub(crate) &'static str);

/// Share of the image that a frame fills; the rest is margin.
const FILL: f64 = 0.92;
/// A portrait lens: little distortion of the nose, still a sense of depth.
const DEFAULT_FOV_DEGREES: f64 = 22.0;

impl Camera {
    /// A camera at `eye` that looks at `target` with `up` approximately upwards.
    ///
    /// # Errors
    /// When arguments are not finite, `eye` is at `target`, `up` points along the view, or the angle or height is out of range.
    pub fn look(eye: Vec3, target: Vec3, up: Vec3, projection: Projection) -> Result<Self, CameraError> {
        if !(eye + target + up).iter().all(|c| c.is_finite()) {
            return Err(CameraError("eye, target and up must be finite"));
        }
        match projection {
            Projection::Perspective { vertical_fov } if !(vertical_fov > 0.0 && vertical_fov < 180.0) => {
                return Err(CameraError("the vertical angle must be above 0 and below 180 degrees"));
            }
            Projection::Orthographic { height } if !(height > 0.0 && height.is_finite()) => {
                return Err(CameraError("the height of an orthographic picture must be positive"));
            }
            _ => {}
        }
        let back = (eye - target).try_normalize(1e-12).ok_or(CameraError("eye and target coincide"))?;
        let right = up.cross(&back).try_normalize(1e-9 * up.norm());
        let right = right.ok_or(CameraError("up is zero or points along the view"))?;
        Ok(Self { eye, right, up: back.cross(&right), back, projection })
    }

    /// A camera at the middle of `frame`, to be moved back until it sees all of it.
    fn within(frame: &Frame, view: View, projection: Projection) -> Self {
        let back = view.direction();
        // From straight above or below, Z is as good as any direction to the top of the picture.
        let right = [Vec3::y(), Vec3::z()].iter().find_map(|up| up.cross(&back).try_normalize(1e-9));
        let right = right.unwrap_or_else(Vec3::x);
        Self { eye: frame.centre, right, up: back.cross(&right), back, projection }
    }

    /// A perspective camera that shows all of `frame` in an image of `size` (width, height) pixels.
    #[must_use]
    pub fn framing(frame: &Frame, view: View, size: [u32; 2]) -> Self {
        let projection = Projection::Perspective { vertical_fov: DEFAULT_FOV_DEGREES };
        let mut camera = Self::within(frame, view, projection);
        let tangent = (DEFAULT_FOV_DEGREES.to_radians() / 2.0).tan() * FILL;
        let aspect = aspect(size);
        let distance = camera
            .corners(frame)
            .map(|[x, y, towards]| towards + (y.abs() / tangent).max(x.abs() / (tangent * aspect)))
            .fold(1e-6, f64::max);
        camera.eye = frame.centre + camera.back * distance;
        camera
    }

    /// The orthographic camera that shows all of `frame`.
    #[must_use]
    pub fn framing_orthographic(frame: &Frame, view: View, size: [u32; 2]) -> Self {
        let unit = Projection::Orthographic { height: 1.0 };
        let mut camera = Self::within(frame, view, unit);
        let aspect = aspect(size);
        let half = camera.corners(frame).map(|[x, y, _]| y.abs().max(x.abs() / aspect)).fold(1e-9, f64::max);
        camera.projection = Projection::Orthographic { height: 2.0 * half / FILL };
        camera.eye = frame.centre + camera.back * (4.0 * frame.half.norm());
        camera
    }

    /// Position of the camera.
    #[must_use]
    pub fn eye(&self) -> Vec3 {
        self.eye
    }

    /// Unit vectors to the right, upwards and towards the viewer.
    #[must_use]
    pub fn axes(&self) -> [Vec3; 3] {
        [self.right, self.up, self.back]
    }

    /// How depth maps to size.
    #[must_use]
    pub fn projection(&self) -> Projection {
        self.projection
    }

    /// A direction given in camera axes (right, up, towards the viewer), in scene axes.
    pub(super) fn to_world(self, v: Vec3) -> Vec3 {
        self.right * v.x + self.up * v.y + self.back * v.z
    }

    /// Unit vector from `point` to the viewer.
    pub(super) fn towards_viewer(&self) -> Vec3 {
        self.back
    }

    /// Is the depth key the reciprocal of depth?
    pub(super) fn is_perspective(&self) -> bool {
        matches!(self.projection, Projection::Perspective { .. })
    }

    /// Pixel coordinates (x to the right, y down, origin at the corner of the first pixel) and a depth key that grows towards
    /// the viewer and is linear on the screen: 1/depth, or -depth when orthographic. `None` behind the camera or not finite.
    #[must_use]
    pub fn project(&self, point: Vec3, size: [u32; 2]) -> Option<[f64; 3]> {
        let d = point - self.eye;
        let (x, y, depth) = (d.dot(&self.right), d.dot(&self.up), -d.dot(&self.back));
        let (width, height) = (f64::from(size[0]), f64::from(size[1]));
        let (scale, key) = match self.projection {
            Projection::Perspective { vertical_fov } => {
                if depth.is_nan() || depth <= 1e-9 {
                    return None;
                }
                (0.5 * height / (vertical_fov.to_radians() / 2.0).tan() / depth, 1.0 / depth)
            }
            Projection::Orthographic { height: millimetres } => (height / millimetres, -depth),
        };
        let pixel = [0.5 * width + x * scale, 0.5 * height - y * scale, key];
        pixel.iter().all(|c| c.is_finite()).then_some(pixel)
    }

    /// Corners of the frame in camera axes about its centre.
    fn corners(&self, frame: &Frame) -> impl Iterator<Item = [f64; 3]> {
        let (frame, camera) = (*frame, *self);
        (0..8).map(move |corner| {
            let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let d = frame.half.component_mul(&Vec3::new(sign(0), sign(1), sign(2)));
            [d.dot(&camera.right), d.dot(&camera.up), d.dot(&camera.back)]
        })
    }
}

fn aspect(size: [u32; 2]) -> f64 {
    f64::from(size[0].max(1)) / f64::from(size[1].max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_fits_in_every_view_and_fills_it() {
        let frame = Frame { centre: Vec3::new(3.0, -20.0, 90.0), half: Vec3::new(70.0, 90.0, 60.0) };
        let size = [400, 300];
        for view in [View::Front, View::ThreeQuarter, View::Side, View::Angles { yaw: -120.0, pitch: 80.0 }] {
            for camera in [Camera::framing(&frame, view, size), Camera::framing_orthographic(&frame, view, size)] {
                let mut reach: f64 = 0.0;
                for corner in 0..8 {
                    let s = |b: i32| f64::from(2 * (corner >> b & 1) - 1);
                    let p = frame.centre + frame.half.component_mul(&Vec3::new(s(0), s(1), s(2)));
                    let [x, y, _] = camera.project(p, size).unwrap();
                    reach = reach.max((x / 200.0 - 1.0).abs()).max((y / 150.0 - 1.0).abs());
                }
                assert!((reach - FILL).abs() < 1e-9, "{view:?}: {reach}");
            }
        }
    }

    #[test]
    fn outliers_and_nan_do_not_shrink_the_subject() {
        let mut points: Vec<Vec3> = (0..=1000).map(|i| Vec3::new(f64::from(i) * 0.1, 1.0, 2.0)).collect();
        let clean = Frame::of(&points);
        assert!((clean.half.x - 50.0).abs() < 1e-12, "a clean range is kept whole");
        points.push(Vec3::new(1e6, f64::NAN, 0.0));
        points.push(Vec3::new(1e6, 1.0, 2.0));
        assert!(Frame::of(&points).half.x < 60.0);
        assert_eq!(Frame::of(&[]).half, Vec3::repeat(1.0));
    }

    #[test]
    fn right_of_the_picture_is_plus_x_and_nearer_has_a_larger_key() {
        let frame = Frame { centre: Vec3::zeros(), half: Vec3::repeat(1.0) };
        for camera in [
            Camera::framing(&frame, View::Front, [100, 100]),
            Camera::framing_orthographic(&frame, View::Front, [100, 100]),
        ] {
            let [x, y, k] = camera.project(Vec3::new(0.5, 0.5, 0.5), [100, 100]).unwrap();
            assert!(x > 50.0 && y < 50.0);
            assert!(k > camera.project(Vec3::zeros(), [100, 100]).unwrap()[2]);
        }
        let camera = Camera::framing(&frame, View::Front, [100, 100]);
        assert!(camera.project(Vec3::new(0.0, 0.0, 1e3), [100, 100]).is_none());
    }
}
