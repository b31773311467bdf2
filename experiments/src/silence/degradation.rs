//! What is wrong with a scan, its landmarks or its rig: one function for each kind.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use anyhow::{Result, bail};
use nonrigid::evaluation::ScanDistance;
use nonrigid::landmark::Landmark;
use nonrigid::mesh::adjacency::EdgeGraph;
use nonrigid::mesh::closest_point::ClosestPoint;
use nonrigid::mesh::normals::{NormalWeighting, face_cross, vertex_normals};
use nonrigid::mesh::{Pose, TriangleMesh, Vec3, rms_size};
use nonrigid::registration::ModelKind;
use nonrigid::rig::{Family, ShapeBasis};
use rand::Rng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use crate::random_pose::{direction, random_pose};
use crate::report::data::upright;
use crate::scan_bench::BenchCase;

/// How far from the face a point of the scan moves with it, and how far apart corners of a triangle may come before it tears, millimetres.
const WITH_THE_FACE: f64 = 15.0;
const TEARS: f64 = 4.0;

/// A case that is about to be registered.
pub struct Trial<'a> {
    /// Scan, truth, landmarks and what a fit may know.
    pub case: BenchCase,
    /// The model.
    pub model: ModelKind,
    /// Makes another person's case on the same template, with his neutral if he is `known`.
    pub other: &'a dyn Fn(bool) -> Result<BenchCase>,
    /// Everything random.
    pub rng: ChaCha8Rng,
}

/// One kind of degradation.
pub struct Kind {
    /// Its name in tables.
    pub name: &'static str,
    /// Whether thresholds may be fitted on it; the others are for tests alone.
    pub design: bool,
    /// Whether a registration can be expected to succeed: a refusal is no answer then.
    pub solvable: bool,
    /// Does it.
    pub apply: fn(&mut Trial<'_>) -> Result<()>,
}

const fn design(name: &'static str, apply: fn(&mut Trial<'_>) -> Result<()>) -> Kind {
    Kind { name, design: true, solvable: true, apply }
}

const fn test(name: &'static str, apply: fn(&mut Trial<'_>) -> Result<()>) -> Kind {
    Kind { name, design: false, solvable: true, apply }
}

const fn hopeless(kind: Kind) -> Kind {
    Kind { solvable: false, ..kind }
}

/// Every kind. The kinds of a pair that resemble each other are split between design and test.
pub const KINDS: [Kind; 62] = [
    design("none", |_| Ok(())),
    design("noise", |t| t.noise(0.3..1.5)),
    test("wavy noise", |t| t.waves(1.0..3.0, 10.0..25.0)),
    design("outliers", |t| t.outliers(0.05..0.2)),
    test("swarm of outliers", |t| t.swarm(0.1..0.3)),
    design("holes", |t| t.holes(6, 8.0..20.0)),
    test("one large hole", |t| t.holes(1, 25.0..45.0)),
    design("crop", |t| t.crop(0.2..0.67)),
    design("upper half", |t| t.keep_above(0.0)),
    test("lower half", |t| t.keep_below(0.1)),
    test("one side", |t| t.keep_side(0.0)),
    design("side view", |t| t.view(60.0..85.0, 0.2)),
    test("view from below", |t| t.view_from(Vec3::new(0.0, -0.8, 0.6), 0.2)),
    test("front view", |t| t.view_from(Vec3::z(), 0.5)),
    design("ball before the face", |t| t.balls(1, 20.0..45.0)),
    test("fingers before the face", |t| t.balls(4, 9.0..14.0)),
    design("beard", |t| t.hair(-0.35, -2.0, 4.0..12.0)),
    test("hair on the forehead", |t| t.hair(2.0, 0.6, 6.0..20.0)),
    design("wall behind", |t| t.wall(40.0..90.0)),
    test("neck and shoulders", |t| t.neck()),
    design("second face beside", |t| t.second_face(180.0..300.0)),
    test("second layer", |t| t.second_layer(1.0..4.0)),
    design("child", |t| t.scaled(0.75..0.9)),
    test("large head", |t| t.scaled(1.1..1.25)),
    design("stretched", |t| t.stretched(1.08..1.25)),
    test("warped", |t| t.waves(2.0..6.0, 80.0..160.0)),
    hopeless(design("mirrored", |t| t.mirrored(true))),
    hopeless(test("mirrored, no landmarks", |t| t.mirrored(false))),
    design("inside out", |t| t.inside_out()),
    design("no landmarks", |t| t.some_landmarks(0)),
    design("any pose, no landmarks", |t| t.any_pose(180.0)),
    test("rolled, no landmarks", |t| t.rolled()),
    design("cropped, no landmarks", |t| {
        t.crop(0.2..0.6)?;
        t.some_landmarks(0)
    }),
    test("child, no landmarks", |t| {
        t.scaled(0.8..0.9)?;
        t.some_landmarks(0)
    }),
    design("landmarks off", |t| t.landmark_noise(3.0..8.0)),
    design("one landmark off", |t| t.landmarks_off(1, 30.0..60.0)),
    test("five landmarks off", |t| t.landmarks_off(5, 15.0..30.0)),
    hopeless(design("landmarks misnamed", |t| t.misnamed())),
    hopeless(test("left and right swapped", |t| t.swapped())),
    design("three landmarks", |t| t.some_landmarks(3)),
    test("four landmarks", |t| t.some_landmarks(4)),
    design("ten landmarks at the brows", |t| t.landmarks_where(10, |p| p.y)),
    test("landmarks of one side", |t| t.landmarks_where(10, |p| p.x)),
    design("wrong neutral", |t| t.wrong_neutral()),
    test("no identity modes", |t| t.without(Family::Identity, 1.0)),
    design("half of the expressions missing", |t| t.without(Family::Expression, 0.5)),
    test("no expressions", |t| t.without(Family::Expression, 1.0)),
    design("no rig, graph", |t| t.with_model(ModelKind::Graph)),
    test("no rig, arap", |t| t.with_model(ModelKind::Arap)),
    design("sequential", |t| t.with_model(ModelKind::Sequential)),
    test("blendshape", |t| t.with_model(ModelKind::Blendshape)),
    design("smoothed", |t| t.smoothed(10..40)),
    test("coarse", |t| t.coarse(4.0..9.0)),
    hopeless(design("ball", |t| t.not_a_face(|_, _| 1.0))),
    hopeless(test("potato", |t| t.not_a_face(|a, b| 1.0 + 0.15 * (3.0 * a).sin() * (2.0 * b).cos()))),
    test("stairs", |t| t.stairs(1.0..3.0)),
    design("unlike the rig", |t| t.waves(1.0..3.0, 55.0..90.0)),
    design("unlike the rig, no landmarks", |t| {
        t.waves(1.0..3.0, 55.0..90.0)?;
        t.some_landmarks(0)
    }),
    design("an expression that the rig lacks, no landmarks", |t| {
        t.beyond_the_rig(0)?;
        t.some_landmarks(0)
    }),
    test("another that the rig lacks, no landmarks", |t| {
        t.beyond_the_rig(1)?;
        t.some_landmarks(0)
    }),
    design("another person as template, graph", |t| t.stranger(ModelKind::Graph)),
    test("another person as template, arap", |t| t.stranger(ModelKind::Arap)),
];

impl Trial<'_> {
    fn draw(&mut self, range: std::ops::Range<f64>) -> f64 {
        self.rng.random_range(range)
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    fn direction(&mut self) -> Vec3 {
        direction(&mut self.rng)
    }

    /// Size of the true face, and its frame: from the template's axes (Y up, Z forward) to the scan.
    fn frame(&self) -> (f64, Pose) {
        let (rest, pose) = (self.case.rest(), upright(&self.case));
        let middle = rest.iter().sum::<Vec3>() / rest.len() as f64;
        (rms_size(rest), Pose { translation: pose.apply(middle), ..pose })
    }

    fn scan_normals(&self) -> Vec<Vec3> {
        let mesh = &self.case.scan.mesh;
        vertex_normals(&mesh.positions, &mesh.triangles, NormalWeighting::Area)
    }

    /// Leaves the triangles for which `keep` says so of centre and normal, in the face's frame and its sizes. What the scan
    /// no longer shows is not observed, and has no landmarks.
    fn keep(&mut self, keep: impl Fn(Vec3, Vec3) -> bool) -> Result<()> {
        let (size, pose) = self.frame();
        let mesh = &mut self.case.scan.mesh;
        let positions = &mesh.positions;
        mesh.triangles.retain(|&t| {
            let centre = t.iter().map(|&v| positions[v as usize]).sum::<Vec3>() / 3.0;
            let normal = face_cross(positions, t).try_normalize(0.0).unwrap_or_default();
            keep(pose.apply_inverse(centre) / size, pose.rotation.tr_mul(&normal))
        });
        self.refresh()
    }

    /// What the scan no longer shows is not observed, and has no landmarks.
    fn refresh(&mut self) -> Result<()> {
        self.case.scan.normals = None;
        let left = ScanDistance::new(&self.case.scan.mesh, None)?;
        let case = &mut self.case;
        case.observed.iter_mut().zip(&case.truth).for_each(|(observed, p)| *observed &= left.of(p) < 3.0);
        case.landmarks.retain(|l| left.of(&l.target) < 10.0);
        Ok(())
    }

    fn displace(&mut self, by: impl Fn(usize, Vec3) -> Vec3) {
        let mesh = &mut self.case.scan.mesh;
        mesh.positions.iter_mut().enumerate().for_each(|(i, p)| *p += by(i, *p));
        self.case.scan.normals = None;
    }

    /// Moves everything that is in the scan's space.
    fn in_place(&mut self, place: impl Fn(Vec3) -> Vec3) {
        let case = &mut self.case;
        let points = case.scan.mesh.positions.iter_mut().chain(&mut case.truth);
        points.chain(case.landmarks.iter_mut().map(|l| &mut l.target)).for_each(|p| *p = place(*p));
        case.scan.normals = None;
    }

    fn add(&mut self, positions: Vec<Vec3>, triangles: impl IntoIterator<Item = [u32; 3]>) {
        let mesh = &mut self.case.scan.mesh;
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(positions);
        mesh.triangles.extend(triangles.into_iter().map(|t| t.map(|v| v + first)));
        self.case.scan.normals = None;
    }

    fn noise(&mut self, sigma: std::ops::Range<f64>) -> Result<()> {
        let sigma = self.draw(sigma);
        let normals = self.scan_normals();
        let heights: Vec<f64> = normals.iter().map(|_| sigma * self.normal()).collect();
        self.displace(|i, _| normals[i] * heights[i]);
        Ok(())
    }

    /// Smooth waves of this height and length; those longer than a feature of the face move the truth as well, as a
    /// scanner that is out of calibration does.
    fn waves(&mut self, height: std::ops::Range<f64>, length: std::ops::Range<f64>) -> Result<()> {
        let (height, length) = (self.draw(height), self.draw(length));
        let waves: Vec<(Vec3, Vec3, f64)> =
            (0..3).map(|_| (self.direction(), self.direction(), self.rng.random_range(0.0..TAU))).collect();
        let wave = move |p: Vec3| -> Vec3 {
            waves.iter().map(|(k, d, phase)| d * (height / 2.0 * (TAU / length * k.dot(&p) + phase).sin())).sum()
        };
        if length > 50.0 {
            self.in_place(|p| p + wave(p));
        } else {
            self.displace(|_, p| wave(p));
        }
        Ok(())
    }

    fn outliers(&mut self, share: std::ops::Range<f64>) -> Result<()> {
        let count = (self.draw(share) * self.case.scan.mesh.triangles.len() as f64) as usize;
        let (size, pose) = self.frame();
        for _ in 0..count {
            let centre = pose.apply(self.direction() * size * self.rng.random_range(0.5..2.0));
            let corners = (0..3).map(|_| centre + self.direction() * 1.5).collect();
            self.add(corners, [[0, 1, 2]]);
        }
        Ok(())
    }

    fn swarm(&mut self, share: std::ops::Range<f64>) -> Result<()> {
        let count = (self.draw(share) * self.case.scan.mesh.triangles.len() as f64) as usize;
        let (size, pose) = self.frame();
        let towards = self.direction();
        let middle = pose.apply(Vec3::new(towards.x, towards.y, towards.z.abs()) * size);
        for _ in 0..count {
            let centre = middle + Vec3::from_fn(|_, _| self.normal()) * 0.25 * size;
            let corners = (0..3).map(|_| centre + self.direction() * 1.5).collect();
            self.add(corners, [[0, 1, 2]]);
        }
        Ok(())
    }

    fn holes(&mut self, count: usize, radius: std::ops::Range<f64>) -> Result<()> {
        let (size, pose) = self.frame();
        let truth = self.case.truth.clone();
        let balls: Vec<(Vec3, f64)> = (0..count)
            .map(|_| {
                let centre = truth[self.rng.random_range(0..truth.len())];
                (pose.apply_inverse(centre) / size, self.draw(radius.clone()) / size)
            })
            .collect();
        self.keep(|p, _| balls.iter().all(|(centre, radius)| (p - centre).norm() > *radius))
    }

    fn crop(&mut self, share: std::ops::Range<f64>) -> Result<()> {
        let (share, direction) = (self.draw(share), self.direction());
        let mesh = &self.case.scan.mesh;
        let (size, pose) = self.frame();
        let height = |t: &[u32; 3]| -> f64 {
            t.iter().map(|&v| direction.dot(&(pose.apply_inverse(mesh.positions[v as usize]) / size))).sum::<f64>()
                / 3.0
        };
        let mut heights: Vec<f64> = mesh.triangles.iter().map(height).collect();
        heights.sort_unstable_by(f64::total_cmp);
        let limit = heights[((1.0 - share) * heights.len() as f64) as usize];
        self.keep(|p, _| direction.dot(&p) < limit)
    }

    fn keep_above(&mut self, height: f64) -> Result<()> {
        self.keep(|p, _| p.y > height)
    }

    fn keep_below(&mut self, height: f64) -> Result<()> {
        self.keep(|p, _| p.y < height)
    }

    fn keep_side(&mut self, at: f64) -> Result<()> {
        let side = if self.rng.random() { 1.0 } else { -1.0 };
        self.keep(|p, _| side * p.x > at)
    }

    fn view(&mut self, yaw: std::ops::Range<f64>, grazing: f64) -> Result<()> {
        let side = if self.rng.random() { 1.0 } else { -1.0 };
        let yaw = side * self.draw(yaw).to_radians();
        self.view_from(Vec3::new(yaw.sin(), 0.0, yaw.cos()), grazing)
    }

    fn view_from(&mut self, from: Vec3, grazing: f64) -> Result<()> {
        let from = from.normalize();
        self.keep(|_, n| n.dot(&from) > grazing)
    }

    /// Balls between a camera and the face: they are in the scan, and what is behind them is not.
    fn balls(&mut self, count: usize, radius: std::ops::Range<f64>) -> Result<()> {
        let (size, pose) = self.frame();
        let first = self.case.truth[self.rng.random_range(0..self.case.truth.len())];
        let along = pose.rotation * Vec3::x();
        for k in 0..count {
            let radius = self.draw(radius.clone());
            let centre = first + along * (2.1 * radius * k as f64) + pose.rotation * Vec3::z() * (radius + 4.0);
            let local = pose.apply_inverse(centre) / size;
            self.keep(|p, _| (p.xy() - local.xy()).norm() > radius / size || p.z > local.z)?;
            let (ball, triangles) = sphere(16, |_, _| radius);
            let front: Vec<[u32; 3]> = triangles
                .into_iter()
                .filter(|t| t.iter().all(|&v| ball[v as usize].dot(&(pose.rotation * Vec3::z())) > -0.1 * radius))
                .collect();
            self.add(ball.into_iter().map(|p| p + centre).collect(), front);
        }
        Ok(())
    }

    /// Hair between two heights (sizes above the middle): the surface is shifted outwards and rough there.
    fn hair(&mut self, below: f64, above: f64, thick: std::ops::Range<f64>) -> Result<()> {
        let thick = self.draw(thick);
        let (size, pose) = self.frame();
        let normals = self.scan_normals();
        let rough: Vec<f64> = normals.iter().map(|_| 1.0 + 0.3 * self.normal()).collect();
        self.displace(|i, p| {
            let y = pose.apply_inverse(p).y / size;
            let rise = ((below - y).min(y - above) / 0.15).clamp(0.0, 1.0);
            normals[i] * (thick * rise * rough[i])
        });
        self.refresh()
    }

    fn wall(&mut self, behind: std::ops::Range<f64>) -> Result<()> {
        let behind = self.draw(behind);
        let (size, pose) = self.frame();
        let (n, wide) = (40, 5.0 * size);
        let at = |i: usize, j: usize| {
            let [x, y] = [i, j].map(|k| (k as f64 / (n - 1) as f64 - 0.5) * wide);
            pose.apply(Vec3::new(x, y, -behind))
        };
        let points = (0..n * n).map(|k| at(k % n, k / n)).collect();
        let index = |i: usize, j: usize| (j * n + i) as u32;
        let cells = (0..(n - 1) * (n - 1)).map(|k| (k % (n - 1), k / (n - 1)));
        let two = |(i, j)| {
            [[index(i, j), index(i + 1, j), index(i + 1, j + 1)], [index(i, j), index(i + 1, j + 1), index(i, j + 1)]]
        };
        self.add(points, cells.flat_map(two).collect::<Vec<_>>());
        Ok(())
    }

    fn neck(&mut self) -> Result<()> {
        let (size, pose) = self.frame();
        for (centre, radii) in [
            (Vec3::new(0.0, -1.6, -1.2), Vec3::new(0.7, 1.2, 0.7)),
            (Vec3::new(0.0, -3.0, -1.3), Vec3::new(2.6, 0.7, 1.0)),
            (Vec3::new(0.0, 0.4, -1.4), Vec3::new(1.1, 1.4, 1.2)),
        ] {
            let (ball, triangles) = sphere(32, |_, _| 1.0);
            let points = ball.into_iter().map(|p| pose.apply((centre + p.component_mul(&radii)) * size)).collect();
            self.add(points, triangles);
        }
        Ok(())
    }

    fn second_face(&mut self, apart: std::ops::Range<f64>) -> Result<()> {
        let beside = Vec3::new(self.draw(apart), self.rng.random_range(-30.0..30.0), 0.0);
        let turn = Vec3::y() * self.rng.random_range(-0.5..0.5);
        let other = (self.other)(false)?.moved(&Pose::rigid(turn, beside));
        self.add(other.scan.mesh.positions, other.scan.mesh.triangles);
        Ok(())
    }

    fn second_layer(&mut self, apart: std::ops::Range<f64>) -> Result<()> {
        let shift = self.direction() * self.draw(apart);
        let mesh = self.case.scan.mesh.clone();
        self.add(mesh.positions.into_iter().map(|p| p + shift).collect(), mesh.triangles);
        Ok(())
    }

    fn scaled(&mut self, by: std::ops::Range<f64>) -> Result<()> {
        let by = self.draw(by);
        self.in_place(|p| p * by);
        Ok(())
    }

    fn stretched(&mut self, by: std::ops::Range<f64>) -> Result<()> {
        let (by, along) = (self.draw(by), self.rng.random_range(0..2));
        let (_, pose) = self.frame();
        let axis = pose.rotation * Vec3::ith(along, 1.0);
        self.in_place(|p| p + axis * ((by - 1.0) * axis.dot(&(p - pose.translation))));
        Ok(())
    }

    fn mirrored(&mut self, landmarks: bool) -> Result<()> {
        self.in_place(|p| Vec3::new(-p.x, p.y, p.z));
        self.case.scan.mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        if landmarks { Ok(()) } else { self.some_landmarks(0) }
    }

    fn inside_out(&mut self) -> Result<()> {
        self.case.scan.mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self.case.scan.normals = None;
        Ok(())
    }

    fn any_pose(&mut self, degrees: f64) -> Result<()> {
        let pose = random_pose(self.rng.random_range(0.0..degrees), 300.0, self.rng.random(), 2);
        self.case = self.case.clone().moved(&pose);
        self.some_landmarks(0)
    }

    fn rolled(&mut self) -> Result<()> {
        let (_, frame) = self.frame();
        let roll = frame.rotation * Vec3::z() * self.rng.random_range(0.8..2.5);
        self.case = self.case.clone().moved(&Pose::rigid(roll, Vec3::zeros()));
        self.some_landmarks(0)
    }

    fn landmark_noise(&mut self, sigma: std::ops::Range<f64>) -> Result<()> {
        let sigma = self.draw(sigma);
        for k in 0..self.case.landmarks.len() {
            let off = Vec3::from_fn(|_, _| self.normal()) * sigma;
            self.case.landmarks[k].target += off;
        }
        Ok(())
    }

    fn landmarks_off(&mut self, count: usize, by: std::ops::Range<f64>) -> Result<()> {
        self.case.landmarks.shuffle(&mut self.rng);
        for k in 0..count.min(self.case.landmarks.len()) {
            let off = self.draw(by.clone());
            let off = self.direction() * off;
            self.case.landmarks[k].target += off;
        }
        Ok(())
    }

    fn misnamed(&mut self) -> Result<()> {
        let targets: Vec<Vec3> = self.case.landmarks.iter().map(|l| l.target).collect();
        let next = targets.iter().cycle().skip(1);
        self.case.landmarks.iter_mut().zip(next).for_each(|(l, target)| l.target = *target);
        Ok(())
    }

    /// Each landmark takes the target of the one nearest to its mirror image.
    fn swapped(&mut self) -> Result<()> {
        let rest = self.case.rest().to_vec();
        let at: Vec<Vec3> = self.case.landmarks.iter().map(|l| l.template.position(&rest)).collect();
        let targets: Vec<Vec3> = self.case.landmarks.iter().map(|l| l.target).collect();
        for (l, p) in self.case.landmarks.iter_mut().zip(&at) {
            let mirror = Vec3::new(-p.x, p.y, p.z);
            let apart = |k: &usize| (at[*k] - mirror).norm();
            let nearest = (0..at.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
            l.target = targets[nearest];
        }
        Ok(())
    }

    fn some_landmarks(&mut self, count: usize) -> Result<()> {
        self.case.landmarks.shuffle(&mut self.rng);
        self.case.landmarks.truncate(count);
        Ok(())
    }

    fn landmarks_where(&mut self, count: usize, most: fn(Vec3) -> f64) -> Result<()> {
        let rest = self.case.rest().to_vec();
        let at = |l: &Landmark| most(l.template.position(&rest));
        self.case.landmarks.sort_by(|a, b| at(b).total_cmp(&at(a)));
        self.case.landmarks.truncate(count);
        Ok(())
    }

    fn wrong_neutral(&mut self) -> Result<()> {
        let other = (self.other)(false)?;
        let other = other.neutral.unwrap_or(other.template.positions);
        // A person's neutral without identity modes: there is nothing else to make up for it.
        self.case.neutral = Some(other);
        self.without(Family::Identity, 1.0)
    }

    /// The template is another person's neutral, without a rig.
    fn stranger(&mut self, model: ModelKind) -> Result<()> {
        let other = (self.other)(true)?;
        self.case.template.positions = other.neutral.unwrap_or(other.template.positions);
        self.case.neutral = None;
        self.with_model(model)
    }

    fn without(&mut self, family: Family, share: f64) -> Result<()> {
        let families: Vec<Family> = self.case.shapes.shapes().iter().map(|shape| shape.family).collect();
        let mut kept = |&k: &usize| families[k] != family || self.rng.random_range(0.0..1.0) >= share;
        let kept: Vec<usize> = (0..families.len()).filter(|k| kept(k)).collect();
        self.keep_shapes(&kept);
        Ok(())
    }

    fn keep_shapes(&mut self, kept: &[usize]) {
        let shapes = &self.case.shapes;
        let slab = (0..3 * shapes.vertex_count())
            .flat_map(|row| kept.iter().map(move |&k| shapes.displacement(row / 3, k)[row % 3] as f32))
            .collect();
        self.case.shapes = match kept.is_empty() {
            true => ShapeBasis::none(),
            false => ShapeBasis::new(kept.iter().map(|&k| shapes.shapes()[k].clone()).collect(), slab),
        };
    }

    /// Makes an expression that the rig no longer has: the one that moves most, as an open mouth does, or one after it.
    fn beyond_the_rig(&mut self, place: usize) -> Result<()> {
        let weight = self.draw(0.5..1.0);
        let pose = self.frame().1;
        let shapes = &self.case.shapes;
        let square =
            |k: usize| -> f64 { (0..shapes.vertex_count()).map(|v| shapes.displacement(v, k).norm_squared()).sum() };
        let mut expressions: Vec<(f64, usize)> = (0..shapes.len())
            .filter(|&k| shapes.shapes()[k].family == Family::Expression)
            .map(|k| (square(k), k))
            .collect();
        expressions.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(&(_, shape)) = expressions.get(place) else { bail!("the rig has no {} expressions", place + 1) };
        let moves: Vec<Vec3> = (0..shapes.vertex_count())
            .map(|v| pose.rotation * (pose.scale * weight * shapes.displacement(v, shape)))
            .collect();
        let truth =
            TriangleMesh { positions: self.case.truth.clone(), triangles: self.case.template.triangulate().triangles };
        let tree = ClosestPoint::new(&truth)?;
        // What floats about stays; lips that touch in the scan come apart.
        let moved = |p: &Vec3| -> Vec3 {
            tree.query_within(p, WITH_THE_FACE.powi(2)).map_or(Vec3::zeros(), |hit| {
                let corners = truth.triangles[hit.triangle as usize];
                corners.iter().zip(hit.barycentric).map(|(&v, b)| moves[v as usize] * b).sum()
            })
        };
        let by: Vec<Vec3> = self.case.scan.mesh.positions.iter().map(moved).collect();
        self.case.scan.mesh.triangles.retain(|t| {
            let [a, b, c] = t.map(|v| by[v as usize]);
            (a - b).norm().max((b - c).norm()).max((c - a).norm()) < TEARS
        });
        self.displace(|i, _| by[i]);
        self.case.truth.iter_mut().zip(&moves).for_each(|(p, by)| *p += by);
        let others: Vec<usize> = (0..self.case.shapes.len()).filter(|k| *k != shape).collect();
        self.keep_shapes(&others);
        self.refresh()
    }

    fn with_model(&mut self, model: ModelKind) -> Result<()> {
        self.model = model;
        if matches!(model, ModelKind::Graph | ModelKind::Arap) {
            self.case.shapes = ShapeBasis::none();
        }
        Ok(())
    }

    fn smoothed(&mut self, rounds: std::ops::Range<usize>) -> Result<()> {
        let rounds = self.rng.random_range(rounds);
        let edges = EdgeGraph::of(&self.case.scan.mesh);
        for _ in 0..rounds {
            let old = self.case.scan.mesh.positions.clone();
            self.displace(|i, p| {
                let round = edges.neighbours(i);
                if round.is_empty() {
                    return Vec3::zeros();
                }
                (round.iter().map(|&j| old[j as usize]).sum::<Vec3>() / round.len() as f64 - p) * 0.5
            });
        }
        Ok(())
    }

    /// Vertices of one cell of a lattice become one.
    fn coarse(&mut self, cell: std::ops::Range<f64>) -> Result<()> {
        let cell = self.draw(cell);
        let mesh = &mut self.case.scan.mesh;
        let mut cells: HashMap<[i64; 3], u32> = HashMap::new();
        let mut sums: Vec<(Vec3, f64)> = Vec::new();
        let places: Vec<u32> = mesh
            .positions
            .iter()
            .map(|p| {
                let key = p.map(|x| (x / cell).floor() as i64).into();
                let place = *cells.entry(key).or_insert_with(|| {
                    sums.push((Vec3::zeros(), 0.0));
                    sums.len() as u32 - 1
                });
                sums[place as usize].0 += p;
                sums[place as usize].1 += 1.0;
                place
            })
            .collect();
        mesh.positions = sums.into_iter().map(|(sum, count)| sum / count).collect();
        mesh.triangles.iter_mut().for_each(|t| *t = t.map(|v| places[v as usize]));
        mesh.triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
        self.case.scan.normals = None;
        Ok(())
    }

    /// Depth in steps.
    fn stairs(&mut self, height: std::ops::Range<f64>) -> Result<()> {
        let height = self.draw(height);
        let (_, pose) = self.frame();
        let forward = pose.rotation * Vec3::z();
        self.displace(|_, p| {
            let z = forward.dot(&(p - pose.translation));
            forward * ((z / height).round() * height - z)
        });
        Ok(())
    }

    /// In place of the face, something as large that is none.
    fn not_a_face(&mut self, radius: fn(f64, f64) -> f64) -> Result<()> {
        let (size, pose) = self.frame();
        let (points, triangles) = sphere(60, |a, b| 1.4 * size * radius(a, b));
        let positions = points.into_iter().map(|p| pose.apply(p)).collect();
        self.case.scan.mesh = TriangleMesh { positions, triangles };
        self.case.scan.normals = None;
        self.case.observed.fill(true);
        self.some_landmarks(0)
    }
}

/// A closed surface about the origin, `n` rings of `2 n`, at this distance in direction (longitude, latitude).
fn sphere(n: usize, radius: impl Fn(f64, f64) -> f64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let mut points = Vec::new();
    for j in 0..=n {
        for i in 0..2 * n {
            let (a, b) = (PI * i as f64 / n as f64, PI * (j as f64 / n as f64 - 0.5));
            points.push(Vec3::new(b.cos() * a.sin(), b.sin(), b.cos() * a.cos()) * radius(a, b));
        }
    }
    let at = |i: usize, j: usize| (j * 2 * n + i % (2 * n)) as u32;
    let cells = (0..n).flat_map(|j| (0..2 * n).map(move |i| (i, j)));
    let two = |(i, j): (usize, usize)| {
        [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    };
    (points, cells.flat_map(two).collect())
}
