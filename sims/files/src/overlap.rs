//! Parts of one robot that lie deep in each other where the file starts them.
//!
//! Nothing is moved: pairs are listed, as starts outside limits are. Solids count as their hulls; planes are left out. A depth is the least way along which the two would be apart, as far as it was searched.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;

use crate::inertia::Pose;
use crate::mesh::directions;
use crate::model::{Model, ModelBody, Solid};
use crate::report::{Effect, Report};

/// Depth of a pair that is listed: metres, and as a share of the thinner one.
const DEEP: f64 = 0.005;
const DEEP_SHARE: f64 = 0.1;
/// Pairs of solids whose boxes meet that are searched; more are not looked at.
const PAIRS_MAX: usize = 20_000;
/// Pairs of a robot and a fixed body; of more, no robot is compared with fixed bodies.
const FIXED_MAX: usize = 100_000;
/// Points of a hull that are looked at.
const POINTS_MAX: usize = 256;

/// Notes pairs of bodies that are part of one robot, can touch, and lie deep in each other.
pub(crate) fn note(model: &Model, report: &mut Report) {
    let joints = model.joints.iter().filter(|joint| !joint.collide);
    let joined: BTreeSet<_> = joints.map(|joint| joint.bodies).collect();
    let mut left = PAIRS_MAX;
    for robot in robots(model) {
        let parts: Vec<_> = robot
            .iter()
            .map(|body| parts(&model.bodies[*body]))
            .collect();
        for (at, place) in robot.iter().enumerate() {
            for (other_at, other_place) in robot.iter().enumerate().skip(at + 1) {
                let (one, other) = (&model.bodies[*place], &model.bodies[*other_place]);
                let (a, b) = (one.groups, other.groups);
                let touch = a.members & b.touches != 0 && b.members & a.touches != 0;
                if left == 0
                    || !touch
                    || one.fixed && other.fixed
                    || joined.contains(&[*place, *other_place])
                {
                    continue;
                }
                if let Some(depth) = deepest(&parts[at], &parts[other_at], &mut left) {
                    let why = "parts of one robot that lie deep in each other at the start drive each other apart";
                    let subject = format!("bodies \"{}\" and \"{}\"", one.name, other.name);
                    let value = format!("{depth:.4} m");
                    report.add(&other.place, subject, value, Effect::Approximated, why);
                }
            }
        }
    }
}

/// The bodies of each robot: moving ones that hold each other, and all fixed ones if it hangs on one of them.
fn robots(model: &Model) -> Vec<Vec<usize>> {
    let mut first: Vec<_> = (0..model.bodies.len()).collect();
    let mut hung = BTreeSet::new();
    for joint in model.joints.iter().filter(|joint| joint.holds) {
        let [holder, held] = joint.bodies;
        if !model.bodies[holder].fixed {
            first[held] = holder;
        } else {
            hung.insert(held);
        }
    }
    let mut robots: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    // A body is held by one of a lower place.
    for (body, own) in model.bodies.iter().enumerate() {
        first[body] = first[first[body].min(body)];
        if !own.fixed {
            robots.entry(first[body]).or_default().push(body);
        }
    }
    let fixed = (0..model.bodies.len()).filter(|body| model.bodies[*body].fixed);
    let fixed: Vec<_> = fixed.collect();
    if fixed.len() * hung.len() <= FIXED_MAX {
        for robot in hung {
            let bodies = robots.entry(first[robot]).or_default();
            bodies.extend(&fixed);
            bodies.sort_unstable();
            bodies.dedup();
        }
    }
    robots.into_values().collect()
}

/// A solid in the world, with the box around it.
struct Part<'a> {
    solid: &'a Solid,
    pose: Pose,
    least: DVec3,
    most: DVec3,
    /// Its least width along its own axes, metres.
    width: f64,
}

fn parts(body: &ModelBody) -> Vec<Part<'_>> {
    let made = body.solids.iter().filter_map(|placed| {
        let (solid, pose) = (&placed.solid, body.pose.of(&placed.pose));
        let along = |axis: DVec3| reach(solid, &pose, axis);
        let most = DVec3::new(along(DVec3::X)?, along(DVec3::Y)?, along(DVec3::Z)?);
        let least = -DVec3::new(along(-DVec3::X)?, along(-DVec3::Y)?, along(-DVec3::Z)?);
        let own = DVec3::AXES.map(|axis| pose.rotation * axis);
        let widths = own.map(|axis| along(axis).zip(along(-axis)).map(|(a, b)| a + b));
        let width = widths.into_iter().flatten().fold(f64::MAX, f64::min);
        Some(Part {
            solid,
            pose,
            least,
            most,
            width,
        })
    });
    made.collect()
}

/// The greatest way of a solid's points along a direction of unit length, metres; `None` for what has no hull.
fn reach(solid: &Solid, pose: &Pose, along: DVec3) -> Option<f64> {
    let own = pose.rotation.conjugate() * along;
    let far = match solid {
        Solid::Ball { radius } => *radius,
        Solid::Cuboid { half } => own.abs().dot(*half),
        Solid::Cylinder { half, radius } => own.z.abs() * half + own.truncate().length() * radius,
        Solid::Capsule { half, radius } => own.z.abs() * half + radius,
        Solid::Ellipsoid { half } => (own * *half).length(),
        Solid::Hull(mesh) | Solid::Mesh(mesh) => {
            let points = mesh
                .points
                .iter()
                .step_by(1 + mesh.points.len() / POINTS_MAX);
            let ways = points.map(|point| point.dot(own));
            ways.reduce(f64::max)?
        }
        Solid::Plane => return None,
    };
    Some(far + pose.position.dot(along))
}

/// The depth of the deepest of some solids in others, if it is deep.
fn deepest(some: &[Part<'_>], others: &[Part<'_>], left: &mut usize) -> Option<f64> {
    let mut deepest = None;
    for one in some {
        for other in others {
            let meet = one.least.cmplt(other.most).all() && other.least.cmplt(one.most).all();
            if !meet || *left == 0 {
                continue;
            }
            *left -= 1;
            let bound = DEEP.max(DEEP_SHARE * one.width.min(other.width));
            let depth = depth(one, other, bound);
            deepest = match (depth, deepest) {
                (Some(new), Some(old)) => Some(f64::max(new, old)),
                (new, old) => new.or(old),
            };
        }
    }
    deepest
}

/// The depth of a pair that is deeper than a bound.
fn depth(one: &Part<'_>, other: &Part<'_>, bound: f64) -> Option<f64> {
    let along = |direction: DVec3| {
        let ways =
            reach(one.solid, &one.pose, direction).zip(reach(other.solid, &other.pose, -direction));
        ways.map_or(0.0, |(one, other)| one + other)
    };
    let own = [one, other].map(|part| DVec3::AXES.map(|axis| part.pose.rotation * axis));
    let own = own.into_iter().flatten().flat_map(|axis| [axis, -axis]);
    let spread = directions(64).map(|direction| direction.as_dvec3().normalize());
    let (mut best, mut depth) = (DVec3::X, f64::MAX);
    for direction in own.chain(spread) {
        let way = along(direction);
        if way < depth {
            (best, depth) = (direction, way);
        }
        if depth < bound {
            return None;
        }
    }
    // The least way is beside the best one that was tried.
    let mut step = 0.2;
    while step > 0.001 && depth >= bound {
        let (across, up) = best.any_orthonormal_pair();
        let near = [across, -across, up, -up].map(|side| (best + side * step).normalize());
        let ways = near.map(along);
        let least = (0..4).min_by(|a, b| ways[*a].total_cmp(&ways[*b]));
        match least.filter(|at| ways[*at] < depth) {
            Some(at) => (best, depth) = (near[at], ways[at]),
            None => step *= 0.5,
        }
    }
    (depth >= bound).then_some(depth)
}

#[cfg(test)]
mod tests {
    use crate::files::MemoryFiles;
    use crate::load::load_text;
    use crate::model::LoadOptions;

    /// The entries of the list for a root and two parts on it, each with a geom.
    fn listed(geoms: [&str; 2], more: &str) -> Vec<String> {
        let [one, other] = geoms;
        let text = format!(
            "<mujoco><worldbody><body name='root'><freejoint/><geom size='0.1' pos='0 0 5'/>\
             <body name='a'><joint/>{one}</body><body name='b'><joint/>{other}</body></body></worldbody>{more}</mujoco>"
        );
        let options = LoadOptions::default();
        let scene = load_text(&MemoryFiles::default(), "m.xml", &text, &options);
        let scene = scene.expect("a robot");
        let notes = scene.report.notes().iter();
        let notes = notes.map(|note| format!("{} {}", note.subject, note.value));
        notes.collect()
    }

    #[test]
    fn parts_that_lie_deep_in_each_other_are_listed_with_the_depth() {
        let long = "<geom type='box' size='0.5 0.1 0.1'/>";
        // Half of a length, of a width, and a corner of a turned one.
        for (other, depth) in [
            (
                "<geom type='box' size='0.1 0.1 0.1' pos='0.5 0 0'/>",
                "0.1000",
            ),
            (
                "<geom type='capsule' size='0.1 0.3' pos='0.2 0.15 0'/>",
                "0.0500",
            ),
            ("<geom size='0.1' pos='0 0 0.12'/>", "0.0800"),
            (
                "<geom type='box' size='0.5 0.1 0.1' pos='0 0.2214213562 0' euler='45 0 0'/>",
                "0.0200",
            ),
        ] {
            let right = format!("bodies \"a\" and \"b\" {depth} m");
            assert_eq!(listed([long, other], ""), [right], "{other}");
            let excluded = "<contact><exclude body1='a' body2='b'/></contact>";
            assert!(listed([long, other], excluded).is_empty(), "{other}");
        }
    }

    #[test]
    fn an_arm_that_lies_deep_in_its_fixed_base_is_listed() {
        let text = "<mujoco><worldbody><geom name='floor' type='plane' size='1 1 1'/><body name='base'>\
            <geom name='column' type='box' size='0.1 0.1 1'/>\
            <body name='lift'><joint type='slide'/><geom type='box' size='0.2 0.2 0.2'/></body></body></worldbody></mujoco>";
        let options = LoadOptions::default();
        let scene = load_text(&MemoryFiles::default(), "m.xml", text, &options);
        let scene = scene.expect("a robot");
        let notes = scene.report.notes().iter();
        let subjects: Vec<_> = notes.map(|note| note.subject.as_str()).collect();
        assert_eq!(subjects, ["bodies \"column\" and \"lift\""]);
    }

    #[test]
    fn parts_that_lie_beside_each_other_are_not_listed() {
        let long = "<geom type='box' size='0.5 0.1 0.1' euler='10 20 30'/>";
        for other in [
            // Along the turned one's own axes: 0.2 m away, and 2 mm in it.
            "<geom type='box' size='0.5 0.1 0.1' euler='10 20 30' pos='-0.09302957 0.16298824 0.06312156'/>",
            "<geom type='capsule' size='0.05 0.3' pos='0 0.6 0'/>",
            "<geom size='0.1' pos='0 0 0.3'/>",
        ] {
            assert!(listed([long, other], "").is_empty(), "{other}");
        }
    }
}
