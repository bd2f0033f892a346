//! Rules: the DIS types of bodies, and the shapes of entities.
//!
//! The first rule that fits decides. Without a fitting rule, a body that can move is of the default kind, a fixed body is
//! not sent, and an entity has the default shape. The text is TOML.

use std::fmt;
use std::time::Duration;

use rhumb_client::scene::{BodyDesc, BodyKind, Shape};
use serde::Deserialize;

use crate::entity::{EntityType, Marking};
use crate::published::Kind;

/// The rules for bodies that become entities, and for entities that become bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// For bodies without a rule that can move.
    pub default_kind: Kind,
    /// For entities without a rule.
    pub default_shape: Shape,
    bodies: Vec<BodyRule>,
    entities: Vec<EntityRule>,
}

#[derive(Clone, Debug, PartialEq)]
struct BodyRule {
    motion: Option<Motion>,
    shape: Option<ShapeKind>,
    indices: Option<[u32; 2]>,
    /// `None`: such bodies are not sent.
    kind: Option<Kind>,
    marking: Option<String>,
}

#[derive(Clone, Debug, PartialEq)]
struct EntityRule {
    pattern: [Option<u16>; 7],
    shape: Shape,
}

/// The source of a body's motion, as rules name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Motion {
    Fixed,
    Kinematic,
    Dynamic,
}

/// The form of a shape, as rules name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ShapeKind {
    Ball,
    Cuboid,
    Capsule,
    Cylinder,
    Cone,
    Hull,
    Mesh,
    Heights,
    Compound,
    HalfSpace,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    body: Vec<BodyText>,
    #[serde(default)]
    entity: Vec<EntityText>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct BodyText {
    motion: Option<Motion>,
    shape: Option<ShapeKind>,
    indices: Option<[u32; 2]>,
    #[serde(default = "yes")]
    send: bool,
    entity_type: Option<String>,
    force: Option<Force>,
    marking: Option<String>,
    metres: Option<f64>,
    degrees: Option<f64>,
    heartbeat: Option<f64>,
    stationary: Option<f64>,
}

const fn yes() -> bool {
    true
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Force {
    Other,
    Friendly,
    Opposing,
    Neutral,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct EntityText {
    entity_type: String,
    shape: String,
}

/// The reason why a text is no file of rules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RulesError {
    /// It is not TOML, or has a key or a value that rules do not have.
    Syntax(String),
    /// A number or a text of a rule is none that its key has.
    Value {
        /// The table, `body` or `entity`.
        table: &'static str,
        /// Its number among them, from one on.
        place: usize,
        /// Its key.
        key: &'static str,
        /// The values that are allowed.
        needed: String,
    },
}

impl fmt::Display for RulesError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Syntax(error) => f.write_str(error.trim_end()),
            Self::Value {
                table,
                place,
                key,
                needed,
            } => write!(f, "[[{table}]] number {place}: {key}: {needed}"),
        }
    }
}

impl std::error::Error for RulesError {}

/// Largest threshold, metres, and the longest heartbeat, seconds: beyond them a setting is a slip.
const METRES_MAX: f64 = 10_000.0;
const HEARTBEAT_MAX: f64 = 3_600.0;

impl Rules {
    /// No rules beside these defaults.
    #[must_use]
    pub const fn new(default_kind: Kind, default_shape: Shape) -> Self {
        Self {
            default_kind,
            default_shape,
            bodies: Vec::new(),
            entities: Vec::new(),
        }
    }

    /// Adds the rules of a file, behind those that are there. A key that a rule leaves out is as in the default kind.
    ///
    /// # Errors
    ///
    /// [`RulesError`] with the line, or with the rule and its key.
    pub fn add(&mut self, text: &str) -> Result<(), RulesError> {
        let file: File =
            toml::from_str(text).map_err(|error| RulesError::Syntax(error.to_string()))?;
        for (index, text) in file.body.into_iter().enumerate() {
            let rule = body_rule(text, self.default_kind, index + 1)?;
            self.bodies.push(rule);
        }
        for (index, text) in file.entity.iter().enumerate() {
            let wrong = |key, needed| RulesError::Value {
                table: "entity",
                place: index + 1,
                key,
                needed,
            };
            self.entities.push(EntityRule {
                pattern: pattern(&text.entity_type)
                    .map_err(|needed| wrong("entity-type", needed))?,
                shape: shape(&text.shape).map_err(|needed| wrong("shape", needed))?,
            });
        }
        Ok(())
    }

    /// The kind of a body; `None` if it is not sent.
    #[must_use]
    pub fn kind_of(&self, body: &BodyDesc, shape: &Shape) -> Option<Kind> {
        let index = body.id.index();
        let Some(rule) = self.bodies.iter().find(|rule| rule.fits(body, shape)) else {
            let moves = body.kind != BodyKind::Fixed;
            return moves.then_some(self.default_kind);
        };
        let marking = |text: &String| Marking::ascii(&text.replace("{}", &index.to_string()));
        rule.kind.map(|kind| Kind {
            marking: rule.marking.as_ref().map_or(kind.marking, marking),
            ..kind
        })
    }

    /// The shape of a foreign entity.
    #[must_use]
    pub fn shape_of(&self, entity_type: EntityType) -> &Shape {
        let numbers = entity_type.numbers();
        let fits = |rule: &&EntityRule| {
            let mut pairs = rule.pattern.iter().zip(numbers);
            pairs.all(|(wanted, number)| wanted.is_none_or(|wanted| wanted == number))
        };
        let rule = self.entities.iter().find(fits);
        rule.map_or(&self.default_shape, |rule| &rule.shape)
    }

    /// The smallest thresholds of any kind that is sent: metres, and radians.
    #[must_use]
    pub fn least_thresholds(&self) -> [f64; 2] {
        let kinds = self.bodies.iter().filter_map(|rule| rule.kind);
        let own = [self.default_kind.metres, self.default_kind.radians];
        kinds.fold(own, |[metres, radians], kind| {
            [metres.min(kind.metres), radians.min(kind.radians)]
        })
    }
}

impl BodyRule {
    fn fits(&self, body: &BodyDesc, shape: &Shape) -> bool {
        let motion = match body.kind {
            BodyKind::Fixed => Motion::Fixed,
            BodyKind::Kinematic => Motion::Kinematic,
            BodyKind::Dynamic => Motion::Dynamic,
        };
        let index = body.id.index();
        self.motion.is_none_or(|wanted| wanted == motion)
            && self
                .shape
                .is_none_or(|wanted| wanted == kind_of_shape(shape))
            && self
                .indices
                .is_none_or(|[first, last]| (first..=last).contains(&index))
    }
}

const fn kind_of_shape(shape: &Shape) -> ShapeKind {
    match shape {
        Shape::Ball { .. } => ShapeKind::Ball,
        Shape::Cuboid { .. } | Shape::RoundedCuboid { .. } => ShapeKind::Cuboid,
        Shape::Capsule { .. } => ShapeKind::Capsule,
        Shape::Cylinder { .. } => ShapeKind::Cylinder,
        Shape::Cone { .. } => ShapeKind::Cone,
        Shape::Hull(_) => ShapeKind::Hull,
        Shape::Mesh(_) => ShapeKind::Mesh,
        Shape::Heights(_) => ShapeKind::Heights,
        Shape::Compound(_) => ShapeKind::Compound,
        Shape::HalfSpace { .. } => ShapeKind::HalfSpace,
    }
}

fn body_rule(text: BodyText, default: Kind, place: usize) -> Result<BodyRule, RulesError> {
    let wrong = |key, needed: String| RulesError::Value {
        table: "body",
        place,
        key,
        needed,
    };
    let number = |key, value: Option<f64>, default: f64, most: f64| match value {
        None => Ok(default),
        Some(value) if value > 0.0 && value <= most => Ok(value),
        Some(value) => Err(wrong(
            key,
            format!("{value} is not above 0 and at most {most}"),
        )),
    };
    if let Some([first, last]) = text.indices.filter(|[first, last]| first > last) {
        return Err(wrong("indices", format!("{first} is above {last}")));
    }
    let entity_type = match &text.entity_type {
        None => default.entity_type,
        Some(text) => {
            (text.parse::<EntityType>()).map_err(|error| wrong("entity-type", error.to_string()))?
        }
    };
    let beat = |key, value, default: Duration| {
        number(key, value, default.as_secs_f64(), HEARTBEAT_MAX).map(Duration::from_secs_f64)
    };
    let degrees = number("degrees", text.degrees, default.radians.to_degrees(), 180.0)?;
    let kind = Kind {
        entity_type,
        force: text.force.map_or(default.force, |force| force as u8),
        marking: default.marking,
        metres: number("metres", text.metres, default.metres, METRES_MAX)?,
        radians: degrees.to_radians(),
        heartbeat: beat("heartbeat", text.heartbeat, default.heartbeat)?,
        stationary: beat("stationary", text.stationary, default.stationary)?,
    };
    Ok(BodyRule {
        motion: text.motion,
        shape: text.shape,
        indices: text.indices,
        kind: text.send.then_some(kind),
        marking: text.marking,
    })
}

/// Parses `1.2.*`: numbers, and `*` for any; what is left out at the end is any.
fn pattern(text: &str) -> Result<[Option<u16>; 7], String> {
    let mut pattern = [None; 7];
    let mut numbers = Vec::new();
    for (index, part) in text.split('.').enumerate() {
        let any = part == "*";
        numbers.push(if any { "0" } else { part });
        if let Some(place) = pattern.get_mut(index) {
            *place = (!any).then_some(0);
        }
    }
    let read: EntityType =
        numbers
            .join(".")
            .parse()
            .map_err(|error: crate::entity::InvalidEntityType| {
                format!("{error}; `*` stands for any number")
            })?;
    for (wanted, number) in pattern.iter_mut().zip(read.numbers()) {
        *wanted = wanted.map(|_| number);
    }
    Ok(pattern)
}

/// Parses a shape: `ball:R`, `cuboid:X,Y,Z`, `capsule:H,R` or `cylinder:H,R`, of half extents and half heights in metres.
///
/// # Errors
///
/// A sentence with the forms that are allowed.
pub fn shape(text: &str) -> Result<Shape, String> {
    let forms = || {
        "must be ball:R, cuboid:X,Y,Z, capsule:H,R or cylinder:H,R in metres, of half extents and half heights".to_owned()
    };
    let (kind, numbers) = text.split_once(':').ok_or_else(forms)?;
    let numbers: Result<Vec<f32>, _> = numbers.split(',').map(|n| n.trim().parse()).collect();
    let shape = match (kind, numbers.as_deref()) {
        ("ball", Ok(&[radius])) => Shape::ball(radius),
        ("cuboid", Ok(&[x, y, z])) => Shape::cuboid(x, y, z),
        ("capsule", Ok(&[half_height, radius])) => Shape::capsule(half_height, radius),
        ("cylinder", Ok(&[half_height, radius])) => Shape::Cylinder {
            half_height,
            radius,
        },
        _ => return Err(forms()),
    };
    shape.check().map_err(|invalid| invalid.to_string())?;
    Ok(shape)
}

#[cfg(test)]
mod tests {
    use rhumb_client::BodyId;
    use rhumb_client::scene::ShapeId;

    use super::*;

    fn rules(text: &str) -> Result<Rules, RulesError> {
        let mut rules = Rules::new(Kind::default(), Shape::ball(0.5));
        rules.add(text).map(|()| rules)
    }

    fn body(index: u32, kind: BodyKind) -> BodyDesc {
        BodyDesc::plain(BodyId::new(index, 1), kind, ShapeId(0))
    }

    #[test]
    fn the_first_rule_that_fits_decides() {
        let text = r#"
            [[body]]
            motion = "dynamic"
            shape = "cuboid"
            entity-type = "1.1.225.1.1"
            force = "friendly"
            marking = "TANK {}"
            metres = 0.5
            degrees = 1.5
            heartbeat = 2
            stationary = 60

            [[body]]
            indices = [10, 19]
            send = false

            [[entity]]
            entity-type = "1.2.*.4"
            shape = "cuboid:5,1,6"
        "#;
        let rules = rules(text).expect("sound rules");
        let tank = rules.kind_of(&body(12, BodyKind::Dynamic), &Shape::cuboid(1.0, 1.0, 1.0));
        let tank = tank.expect("it is sent");
        assert_eq!(tank.entity_type.to_string(), "1.1.225.1.1.0.0");
        assert_eq!((tank.force, &tank.marking.text), (1, b"TANK 12\0\0\0\0"));
        assert_eq!(tank.heartbeat, Duration::from_secs(2));
        assert_eq!(tank.stationary, Duration::from_secs(60));
        assert!(
            (tank.metres - 0.5).abs() < 1e-12
                && (tank.radians - 1.5_f64.to_radians()).abs() < 1e-12
        );
        let ball = Shape::ball(1.0);
        assert_eq!(rules.kind_of(&body(12, BodyKind::Dynamic), &ball), None);
        assert_eq!(rules.kind_of(&body(9, BodyKind::Fixed), &ball), None);
        assert_eq!(
            rules.kind_of(&body(9, BodyKind::Kinematic), &ball),
            Some(Kind::default())
        );
        let plane = "1.2.71.4.9".parse().expect("a type");
        assert_eq!(rules.shape_of(plane), &Shape::cuboid(5.0, 1.0, 6.0));
        let other = "1.2.71.5".parse().expect("a type");
        assert_eq!(rules.shape_of(other), &Shape::ball(0.5));
        let [metres, radians] = rules.least_thresholds();
        assert!((metres - 0.5).abs() < 1e-12);
        assert!((radians - 1.5_f64.to_radians()).abs() < 1e-12);
    }

    #[test]
    fn a_wrong_rule_is_named() {
        for (text, part) in [
            (
                "[[body]]\nmetres = 0",
                "[[body]] number 1: metres: 0 is not above 0 and at most 10000",
            ),
            (
                "[[body]]\n[[body]]\ndegrees = 181",
                "[[body]] number 2: degrees: 181",
            ),
            ("[[body]]\nheartbeat = nan", "heartbeat: NaN is not above 0"),
            ("[[body]]\nindices = [3, 2]", "indices: 3 is above 2"),
            (
                "[[body]]\nentity-type = \"1.x\"",
                "entity-type: part 2 of an entity type",
            ),
            (
                "[[entity]]\nentity-type = \"1.*.1.1.1.1.1.1\"\nshape = \"ball:1\"",
                "seven numbers",
            ),
            (
                "[[entity]]\nentity-type = \"1\"\nshape = \"ball:-1\"",
                "[[entity]] number 1: shape:",
            ),
            (
                "[[entity]]\nentity-type = \"1\"\nshape = \"egg\"",
                "must be ball:R",
            ),
            ("[[body]]\ncolour = 1", "line 2, column 1"),
            ("[[body]\n", "line 1"),
        ] {
            let error = rules(text).expect_err(text).to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
