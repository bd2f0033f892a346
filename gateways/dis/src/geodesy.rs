//! The Earth of DIS: WGS84, and a tangent frame in which a scene stands.
//!
//! All in f64, so that a point a thousand kilometres up keeps nanometres. Heights are above the ellipsoid; there is no
//! geoid and no terrain.

use core::f64::consts::FRAC_PI_2;
use core::fmt;

use glam::{DMat3, DQuat, DVec3};

/// Equatorial radius, metres (WGS84).
const A: f64 = 6_378_137.0;
/// Flattening (WGS84).
const F: f64 = 1.0 / 298.257_223_563;
/// Polar radius, metres.
const B: f64 = A * (1.0 - F);
/// Square of the first eccentricity.
const E2: f64 = F * (2.0 - F);
/// Square of the second eccentricity.
const EP2: f64 = E2 / ((1.0 - F) * (1.0 - F));
/// Nearest to the Earth's centre at which a height is defined, metres: beyond the evolute of the ellipse, 43 km.
const CENTRE: f64 = 100_000.0;
/// Steps of the latitude. Between −10 km and 1,000 km two suffice.
const STEPS: u32 = 8;

/// A point by latitude, longitude and height above the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    latitude: f64,
    longitude: f64,
    height: f64,
}

/// The reason why numbers are no point of the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidPlace {
    /// A latitude that is not in [−90, 90].
    Latitude {
        /// As given, degrees.
        degrees: f64,
    },
    /// A longitude that is not in [−360, 360].
    Longitude {
        /// As given, degrees.
        degrees: f64,
    },
    /// A height that is not in [−100 km, 10,000 km].
    Height {
        /// As given, metres.
        metres: f64,
    },
    /// A geocentric point too near to the Earth's centre, or not finite.
    Centre {
        /// Its distance from the centre, metres.
        metres: f64,
    },
}

impl fmt::Display for InvalidPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Latitude { degrees } => {
                write!(f, "latitude {degrees}° is not within -90° to 90°")
            }
            Self::Longitude { degrees } => {
                write!(f, "longitude {degrees}° is not within -360° to 360°")
            }
            Self::Height { metres } => {
                write!(f, "height {metres} m is not within -100000 m to 10000000 m")
            }
            Self::Centre { metres } => {
                write!(
                    f,
                    "point {metres} m from the Earth's centre is not at {CENTRE} m or more"
                )
            }
        }
    }
}

impl core::error::Error for InvalidPlace {}

impl Geodetic {
    /// A point by degrees of latitude north, degrees of longitude east, and metres above the ellipsoid.
    ///
    /// # Errors
    ///
    /// [`InvalidPlace`] for a number that is out of range or not finite.
    pub fn from_degrees(latitude: f64, longitude: f64, height: f64) -> Result<Self, InvalidPlace> {
        if !(-90.0..=90.0).contains(&latitude) {
            return Err(InvalidPlace::Latitude { degrees: latitude });
        }
        if !(-360.0..=360.0).contains(&longitude) {
            return Err(InvalidPlace::Longitude { degrees: longitude });
        }
        if !(-1e5..=1e7).contains(&height) {
            return Err(InvalidPlace::Height { metres: height });
        }
        Ok(Self {
            latitude: latitude.to_radians(),
            longitude: longitude.to_radians(),
            height,
        })
    }

    /// The point of geocentric coordinates, metres. The longitude is in (−180°, 180°].
    ///
    /// # Errors
    ///
    /// [`InvalidPlace::Centre`] within 100 km of the Earth's centre, and for numbers that are not finite.
    pub fn from_geocentric(point: DVec3) -> Result<Self, InvalidPlace> {
        let metres = point.length();
        if !(metres.is_finite() && metres >= CENTRE) {
            return Err(InvalidPlace::Centre { metres });
        }
        let (p, z) = (point.x.hypot(point.y), point.z);
        // Bowring's step on the parametric latitude. Sine and cosine come from two sides of a triangle, never from a
        // division by one of them, so that poles and equator are points like others.
        let (mut sin, mut cos) = normal(z, p * (1.0 - F));
        let mut latitude = (0.0, 1.0);
        for _ in 0..STEPS {
            latitude = normal(z + EP2 * B * sin * sin * sin, p - E2 * A * cos * cos * cos);
            let next = normal(latitude.0 * (1.0 - F), latitude.1);
            if next == (sin, cos) {
                break;
            }
            (sin, cos) = next;
        }
        let (sin, cos) = latitude;
        Ok(Self {
            latitude: sin.atan2(cos).clamp(-FRAC_PI_2, FRAC_PI_2),
            longitude: point.y.atan2(point.x),
            height: p * cos + z * sin - A * (1.0 - E2 * sin * sin).sqrt(),
        })
    }

    /// Geocentric coordinates, metres.
    #[must_use]
    pub fn to_geocentric(self) -> DVec3 {
        let (sin, cos) = self.latitude.sin_cos();
        let (sin_long, cos_long) = self.longitude.sin_cos();
        let normal = A / (1.0 - E2 * sin * sin).sqrt();
        let out = (normal + self.height) * cos;
        DVec3::new(
            out * cos_long,
            out * sin_long,
            (normal * (1.0 - E2) + self.height) * sin,
        )
    }

    /// Degrees north.
    #[must_use]
    pub const fn latitude_degrees(self) -> f64 {
        self.latitude.to_degrees()
    }

    /// Degrees east.
    #[must_use]
    pub const fn longitude_degrees(self) -> f64 {
        self.longitude.to_degrees()
    }

    /// Metres above the ellipsoid.
    #[must_use]
    pub const fn height_metres(self) -> f64 {
        self.height
    }
}

/// Sine and cosine of the angle of a triangle with these two sides.
fn normal(opposite: f64, adjacent: f64) -> (f64, f64) {
    let long = opposite.hypot(adjacent);
    (opposite / long, adjacent / long)
}

/// The directions of a scene's axes on the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SceneAxes {
    /// x east, y up, z south.
    #[default]
    YUp,
    /// x east, y north, z up.
    ZUp,
}

impl SceneAxes {
    /// Entity axes in a body's own axes: a body's x is forward, and the body's up is the scene's.
    #[must_use]
    pub const fn entity_in_body(self) -> DQuat {
        match self {
            Self::YUp => DQuat::from_xyzw(HALF, 0.0, 0.0, HALF),
            Self::ZUp => DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0),
        }
    }
}

/// Sine of 45°.
const HALF: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// A scene's frame, tangent to the ellipsoid at its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TangentFrame {
    origin: DVec3,
    /// Scene → geocentric.
    axes: DMat3,
    rotation: DQuat,
}

impl TangentFrame {
    /// The frame whose origin is at this point. At a pole the longitude says where east is.
    #[must_use]
    pub fn new(origin: Geodetic, axes: SceneAxes) -> Self {
        let (sin, cos) = origin.latitude.sin_cos();
        let (sin_long, cos_long) = origin.longitude.sin_cos();
        let east = DVec3::new(-sin_long, cos_long, 0.0);
        let north = DVec3::new(-sin * cos_long, -sin * sin_long, cos);
        let up = DVec3::new(cos * cos_long, cos * sin_long, sin);
        let axes = match axes {
            SceneAxes::YUp => DMat3::from_cols(east, up, -north),
            SceneAxes::ZUp => DMat3::from_cols(east, north, up),
        };
        let rotation = DQuat::from_mat3(&axes).normalize();
        Self {
            origin: origin.to_geocentric(),
            axes,
            rotation,
        }
    }

    /// A point of the scene, geocentric.
    #[must_use]
    pub fn point_to_geocentric(&self, point: DVec3) -> DVec3 {
        self.origin + self.axes * point
    }

    /// A geocentric point, in the scene.
    #[must_use]
    pub fn point_to_scene(&self, point: DVec3) -> DVec3 {
        self.axes.transpose() * (point - self.origin)
    }

    /// A direction or velocity of the scene, along geocentric axes.
    #[must_use]
    pub fn vector_to_geocentric(&self, vector: DVec3) -> DVec3 {
        self.axes * vector
    }

    /// A direction or velocity along geocentric axes, in the scene.
    #[must_use]
    pub fn vector_to_scene(&self, vector: DVec3) -> DVec3 {
        self.axes.transpose() * vector
    }

    /// The rotation from the scene's axes to geocentric ones.
    #[must_use]
    pub const fn rotation(&self) -> DQuat {
        self.rotation
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LATITUDES: [f64; 13] = [
        -90.0,
        -89.999_999,
        -89.99,
        -89.0,
        -45.0,
        -1e-9,
        0.0,
        30.0,
        60.0,
        85.0,
        89.99,
        89.999_999,
        90.0,
    ];
    const HEIGHTS: [f64; 6] = [-10_000.0, 0.0, 1.0, 8_848.0, 100_000.0, 1_000_000.0];

    #[test]
    fn points_return_to_a_micrometre_from_pole_to_pole() {
        for latitude in LATITUDES {
            for longitude in [
                -180.0,
                -179.999_999,
                -90.0,
                0.0,
                12.5,
                90.0,
                179.999_999,
                180.0,
            ] {
                for height in HEIGHTS {
                    let place =
                        Geodetic::from_degrees(latitude, longitude, height).expect("in range");
                    let point = place.to_geocentric();
                    let back = Geodetic::from_geocentric(point).expect("far from the centre");
                    let off = (back.to_geocentric() - point).length();
                    assert!(off < 1e-6, "{latitude} {longitude} {height}: {off} m");
                    let rise = (back.height_metres() - height).abs();
                    assert!(
                        rise < 1e-6,
                        "{latitude} {longitude} {height}: {rise} m of height"
                    );
                    let turn = (back.latitude_degrees() - latitude).abs();
                    assert!(
                        turn < 1e-12,
                        "{latitude} {longitude} {height}: {turn}° of latitude"
                    );
                }
            }
        }
    }

    #[test]
    fn the_axes_of_the_earth_are_where_the_standard_has_them() {
        let point = |latitude, longitude| {
            let place = Geodetic::from_degrees(latitude, longitude, 10.0).expect("in range");
            place.to_geocentric()
        };
        let near = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-8, "{a} and {b}");
        near(point(0.0, 0.0), DVec3::new(6_378_147.0, 0.0, 0.0));
        near(point(0.0, 90.0), DVec3::new(0.0, 6_378_147.0, 0.0));
        near(
            point(90.0, 0.0),
            DVec3::new(0.0, 0.0, 6_356_762.314_245_179),
        );
        near(
            point(-90.0, 77.0),
            DVec3::new(0.0, 0.0, -6_356_762.314_245_179),
        );
    }

    #[test]
    fn a_point_at_the_centre_or_beyond_numbers_is_refused() {
        for point in [DVec3::ZERO, DVec3::X, DVec3::NAN, DVec3::INFINITY] {
            assert!(Geodetic::from_geocentric(point).is_err(), "{point}");
        }
        assert!(Geodetic::from_degrees(90.1, 0.0, 0.0).is_err());
        assert!(Geodetic::from_degrees(f64::NAN, 0.0, 0.0).is_err());
        assert!(Geodetic::from_degrees(0.0, 0.0, f64::INFINITY).is_err());
    }

    #[test]
    fn up_is_up_in_both_axes_of_scenes_at_every_latitude() {
        for latitude in LATITUDES {
            let place = Geodetic::from_degrees(latitude, 33.0, 5.0).expect("in range");
            let above = Geodetic::from_degrees(latitude, 33.0, 6.0)
                .expect("in range")
                .to_geocentric();
            for (axes, up) in [(SceneAxes::YUp, DVec3::Y), (SceneAxes::ZUp, DVec3::Z)] {
                let frame = TangentFrame::new(place, axes);
                assert!((frame.point_to_geocentric(up) - above).length() < 1e-8);
                assert!((frame.point_to_scene(above) - up).length() < 1e-8);
                assert!((frame.rotation() * up - frame.vector_to_geocentric(up)).length() < 1e-15);
                // Down of the entity is down of the body.
                assert!((axes.entity_in_body() * DVec3::Z + up).length() < 1e-15);
                assert!((axes.entity_in_body() * DVec3::X - DVec3::X).length() < 1e-15);
            }
        }
    }

    proptest! {
        #[test]
        fn a_scene_point_returns(
            latitude in -90.0..90.0, longitude in -180.0..180.0, height in -1e4..1e6,
            p in prop::array::uniform3(-1e5..1e5),
        ) {
            let place = Geodetic::from_degrees(latitude, longitude, height).expect("in range");
            let frame = TangentFrame::new(place, SceneAxes::YUp);
            let p = DVec3::from(p);
            prop_assert!((frame.point_to_scene(frame.point_to_geocentric(p)) - p).length() < 1e-8);
            prop_assert!((frame.vector_to_scene(frame.vector_to_geocentric(p)) - p).length() < 1e-9);
        }
    }
}
