// Rhumb for C++17, header only, over rhumb.h.
//
// Handles close themselves, errors are exceptions, arrays are ranges.
//
// The rules of rhumb.h on threads and units hold here too. Every call throws rhumb::Error when it fails; using a scene that
// was closed or moved from is an error too.

#ifndef RHUMB_HPP
#define RHUMB_HPP

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rhumb.h"

namespace rhumb {

/// A call failed: the code says which kind of error it is, what() says it in a sentence.
class Error : public std::runtime_error {
public:
    Error(RhumbCode code, const std::string& sentence) : std::runtime_error(sentence), code_(code) {}

    RhumbCode code() const noexcept { return code_; }

private:
    RhumbCode code_;
};

/// A request that the server refused, and that changed nothing.
struct Refusal {
    /// The command's number; none for a request for authority.
    std::optional<std::uint64_t> number;
    /// The body that the request is about, or zero.
    RhumbBody body;
    /// The reason in one or a few words, such as "unknown body".
    std::string reason;
    /// The reason, a sentence.
    std::string text;
};

/// The server refused requests of earlier calls. advance, wait and poll throw it after they have done their work, and the
/// next call continues. Join with RHUMB_REFUSALS_EVENTS to get refusals as events alone.
class RefusedError : public Error {
public:
    RefusedError(const std::string& sentence, std::vector<Refusal> refusals)
        : Error(RHUMB_CODE_REFUSED, sentence), refusals_(std::move(refusals)) {}

    /// At least one, the oldest first.
    const std::vector<Refusal>& refusals() const noexcept { return refusals_; }

private:
    std::vector<Refusal> refusals_;
};

/// Throws unless the call did what it says. Unreal has macros of the names check, verify and ensure.
inline void throw_unless_ok(RhumbCode code) {
    if (code != RHUMB_CODE_OK) {
        throw Error(code, rhumb_last_error());
    }
}

/// The text as C reads it. A zero byte would end it there.
inline const char* c_text(const std::string& text, const char* what) {
    if (text.find('\0') != std::string::npos) {
        throw Error(RHUMB_CODE_INVALID, std::string(what) + " has a zero byte, and must have none");
    }
    return text.c_str();
}

using Body = RhumbBody;
using Hit = RhumbHit;
using Event = RhumbEvent;
using Statistics = RhumbStatistics;
using Time = RhumbTime;

struct Vec3 {
    float x, y, z;
};

/// A unit quaternion.
struct Quat {
    float x, y, z, w;
};

static_assert(sizeof(Vec3) == 3 * sizeof(float) && sizeof(Quat) == 4 * sizeof(float), "arrays of floats are read as such");

namespace detail {

inline void set(float (&to)[3], Vec3 from) {
    to[0] = from.x;
    to[1] = from.y;
    to[2] = from.z;
}

inline void set(float (&to)[4], Quat from) {
    to[0] = from.x;
    to[1] = from.y;
    to[2] = from.z;
    to[3] = from.w;
}

}  // namespace detail

/// Elements that something else owns.
template <typename T>
class Slice {
public:
    Slice(const T* data, std::size_t size) noexcept : data_(data), size_(size) {}

    const T* data() const noexcept { return data_; }
    std::size_t size() const noexcept { return size_; }
    bool empty() const noexcept { return size_ == 0; }
    const T* begin() const noexcept { return data_; }
    const T* end() const noexcept { return data_ + size_; }

    /// Throws std::out_of_range for a place that is not there.
    const T& operator[](std::size_t place) const {
        if (place >= size_) {
            throw std::out_of_range("place " + std::to_string(place) + " of " + std::to_string(size_));
        }
        return data_[place];
    }

private:
    const T* data_;
    std::size_t size_;
};

/// A shape; long axes point up. Its origin is its body's centre of mass, but for hulls and compounds: see `centre`. Lengths
/// in the scene's unit.
class Shape {
public:
    static Shape ball(float radius) {
        Shape shape(RHUMB_SHAPE_KIND_BALL);
        shape.raw_.radius = radius;
        return shape;
    }

    /// By half the edge lengths.
    static Shape cuboid(float x, float y, float z) {
        Shape shape(RHUMB_SHAPE_KIND_CUBOID);
        shape.set_half_extents(x, y, z);
        return shape;
    }

    static Shape rounded_cuboid(float x, float y, float z, float radius) {
        Shape shape(RHUMB_SHAPE_KIND_ROUNDED_CUBOID);
        shape.set_half_extents(x, y, z);
        shape.raw_.radius = radius;
        return shape;
    }

    static Shape capsule(float half_height, float radius) { return round(RHUMB_SHAPE_KIND_CAPSULE, half_height, radius); }

    static Shape cylinder(float half_height, float radius) { return round(RHUMB_SHAPE_KIND_CYLINDER, half_height, radius); }

    static Shape cone(float half_height, float radius) { return round(RHUMB_SHAPE_KIND_CONE, half_height, radius); }

    /// Everything behind a plane; the normal points out of it.
    static Shape half_space(Vec3 normal) {
        Shape shape(RHUMB_SHAPE_KIND_HALF_SPACE);
        shape.raw_.normal[0] = normal.x;
        shape.raw_.normal[1] = normal.y;
        shape.raw_.normal[2] = normal.z;
        return shape;
    }

    /// The convex hull of points, which may be given from anywhere: see centre. It has 255 corners at most; other points are
    /// left out.
    static Shape hull(const std::vector<Vec3>& points) {
        Shape shape(RHUMB_SHAPE_KIND_HULL);
        shape.set_points(points);
        return shape;
    }

    /// Three places of points for each triangle.
    static Shape mesh(const std::vector<Vec3>& points, std::vector<std::uint32_t> corners) {
        Shape shape(RHUMB_SHAPE_KIND_MESH);
        shape.set_points(points);
        if (corners.size() % 3 != 0) {
            throw Error(RHUMB_CODE_INVALID, "the corners of a mesh must be three for each triangle");
        }
        shape.corners_ = std::move(corners);
        return shape;
    }

    /// Heights, one row after the other. The first post is at the body's origin; the rows follow each other along x, the
    /// columns along the other axis of the ground.
    static Shape heights(std::uint32_t rows, float row_spacing, float column_spacing, std::vector<float> heights) {
        Shape shape(RHUMB_SHAPE_KIND_HEIGHTS);
        shape.raw_.rows = rows;
        shape.raw_.row_spacing = row_spacing;
        shape.raw_.column_spacing = column_spacing;
        shape.raw_.point_count = heights.size();
        shape.points_ = std::move(heights);
        return shape;
    }

    /// How bodies touch the edges that two triangles of a mesh or of heights share.
    Shape& edges(RhumbEdges edges) noexcept {
        raw_.edges = static_cast<std::uint32_t>(edges);
        return *this;
    }

    /// A shape in a compound, in the axes of the body, from the origin of the compound.
    struct Part;

    /// Several shapes, none of which is a compound.
    static Shape compound(const std::vector<Part>& parts);

    /// The centre of mass, from the origin in the axes of the shape: another for hulls and compounds alone. Poses of a body
    /// of such a shape are those of its origin, for the client that added it.
    Vec3 centre() const {
        const RhumbShape shape = raw();
        Vec3 centre{};
        throw_unless_ok(rhumb_shape_centre(&shape, &centre.x));
        return centre;
    }

    /// The struct of rhumb.h; valid as long as this shape.
    RhumbShape raw() const noexcept {
        RhumbShape raw = raw_;
        raw.points = points_.data();
        raw.triangles = corners_.data();
        raw.triangle_count = corners_.size() / 3;
        if (parts_) {
            raw.parts = parts_->raw.data();
            raw.part_count = parts_->raw.size();
        }
        return raw;
    }

private:
    explicit Shape(RhumbShapeKind kind) {
        RhumbBodyDesc plain;
        throw_unless_ok(rhumb_body_desc_init(&plain));
        raw_ = plain.shape;
        raw_.kind = static_cast<std::uint32_t>(kind);
    }

    static Shape round(RhumbShapeKind kind, float half_height, float radius) {
        Shape shape(kind);
        shape.raw_.half_height = half_height;
        shape.raw_.radius = radius;
        return shape;
    }

    void set_half_extents(float x, float y, float z) {
        raw_.half_extents[0] = x;
        raw_.half_extents[1] = y;
        raw_.half_extents[2] = z;
    }

    void set_points(const std::vector<Vec3>& points) {
        for (const Vec3& point : points) {
            points_.insert(points_.end(), {point.x, point.y, point.z});
        }
        raw_.point_count = points.size();
    }

    /// Parts that all copies of a compound share; nothing changes or moves them.
    struct Parts {
        std::vector<Shape> shapes;
        std::vector<RhumbShape> raw_shapes;
        std::vector<RhumbPart> raw;
    };

    RhumbShape raw_;
    std::vector<float> points_;
    std::vector<std::uint32_t> corners_;
    std::shared_ptr<const Parts> parts_;
};

struct Shape::Part {
    Shape shape;
    Vec3 position;
    Quat rotation = {0, 0, 0, 1};
};

inline Shape Shape::compound(const std::vector<Part>& parts) {
    auto kept = std::make_shared<Parts>();
    for (const Part& part : parts) {
        kept->shapes.push_back(part.shape);
    }
    for (const Shape& shape : kept->shapes) {
        kept->raw_shapes.push_back(shape.raw());
    }
    for (std::size_t i = 0; i < parts.size(); ++i) {
        const Vec3 at = parts[i].position;
        const Quat turned = parts[i].rotation;
        kept->raw.push_back({{at.x, at.y, at.z}, {turned.x, turned.y, turned.z, turned.w}, &kept->raw_shapes[i]});
    }
    Shape shape(RHUMB_SHAPE_KIND_COMPOUND);
    shape.parts_ = std::move(kept);
    return shape;
}

/// A body to add.
class BodyDesc {
public:
    /// A body that the engine moves.
    static BodyDesc dynamic(Shape shape) { return BodyDesc(RHUMB_BODY_KIND_DYNAMIC, std::move(shape)); }

    /// A body that nothing moves, such as a floor.
    static BodyDesc fixed(Shape shape) { return BodyDesc(RHUMB_BODY_KIND_FIXED, std::move(shape)); }

    /// A body that commands move; it pushes others and is not pushed.
    static BodyDesc kinematic(Shape shape) { return BodyDesc(RHUMB_BODY_KIND_KINEMATIC, std::move(shape)); }

    BodyDesc& at(float x, float y, float z) {
        detail::set(raw_.position, Vec3{x, y, z});
        return *this;
    }

    BodyDesc& rotation(Quat rotation) {
        const float numbers[] = {rotation.x, rotation.y, rotation.z, rotation.w};
        for (std::size_t i = 0; i < 4; ++i) {
            raw_.rotation[i] = numbers[i];
        }
        return *this;
    }

    BodyDesc& linear_velocity(Vec3 velocity) {
        detail::set(raw_.linear_velocity, velocity);
        return *this;
    }

    /// rad/s about world axes.
    BodyDesc& angular_velocity(Vec3 velocity) {
        detail::set(raw_.angular_velocity, velocity);
        return *this;
    }

    /// Density in kg/m³.
    BodyDesc& material(float friction, float restitution, float density) {
        raw_.has_material = 1;
        raw_.friction = friction;
        raw_.restitution = restitution;
        raw_.density = density;
        return *this;
    }

    BodyDesc& mass(float kilograms) {
        raw_.has_mass = 1;
        raw_.mass = kilograms;
        return *this;
    }

    /// Moments of inertia about the body's axes, kg·m², in place of those of its shape; needs a mass.
    BodyDesc& moments(Vec3 moments) {
        raw_.has_moments = 1;
        detail::set(raw_.moments, moments);
        return *this;
    }

    BodyDesc& gravity_scale(float factor) {
        raw_.gravity_scale = factor;
        return *this;
    }

    BodyDesc& sensor() {
        raw_.sensor = 1;
        return *this;
    }

    /// Sweeps it against moving bodies, so that it does not pass through them.
    BodyDesc& swept() {
        raw_.swept = 1;
        return *this;
    }

    /// Its axis of spin stays, though its moments of inertia differ.
    BodyDesc& without_gyroscopic_forces() {
        raw_.gyroscopic = 0;
        return *this;
    }

    /// It never falls asleep by itself, or only once it has settled, in place of the scene's conditions.
    BodyDesc& sleep(RhumbSleep rule) {
        raw_.sleep = static_cast<std::uint32_t>(rule);
        return *this;
    }

    /// It sleeps once it is slow for so many seconds: units of length per second of its fastest point, and rad/s.
    BodyDesc& sleep_below(float speed, float angular_speed, float seconds) {
        raw_.sleep_speed = speed;
        raw_.sleep_angular_speed = angular_speed;
        raw_.sleep_seconds = seconds;
        return sleep(RHUMB_SLEEP_BELOW);
    }

    /// Every other field, as rhumb.h names it. Its shape is replaced by this body's.
    RhumbBodyDesc& fields() noexcept { return raw_; }

    /// The struct of rhumb.h; valid as long as this body.
    RhumbBodyDesc raw() const noexcept {
        RhumbBodyDesc raw = raw_;
        raw.shape = shape_.raw();
        return raw;
    }

private:
    BodyDesc(RhumbBodyKind kind, Shape shape) : shape_(std::move(shape)) {
        throw_unless_ok(rhumb_body_desc_init(&raw_));
        raw_.kind = static_cast<std::uint32_t>(kind);
    }

    RhumbBodyDesc raw_;
    Shape shape_;
};

/// A motor of a joint. Position and velocity that it drives to, stiffness in 1/s², damping in 1/s; no force means any.
struct Motor {
    float position = 0;
    float velocity = 0;
    float stiffness = 0;
    float damping = 0;
    std::optional<float> force = std::nullopt;
};

/// A joint of two bodies. Axes: 0 to 2 along x, y, z of its frames, 3 to 5 about them.
class JointDesc {
public:
    JointDesc(RhumbJointKind kind, Body first, Body second) {
        throw_unless_ok(rhumb_joint_desc_init(&raw_));
        raw_.kind = static_cast<std::uint32_t>(kind);
        raw_.first = first;
        raw_.second = second;
    }

    /// From the centres of mass of the bodies, along their axes.
    JointDesc& anchors(Vec3 first, Vec3 second) {
        detail::set(raw_.first_frame.anchor, first);
        detail::set(raw_.second_frame.anchor, second);
        return *this;
    }

    /// Frames to bodies.
    JointDesc& rotations(Quat first, Quat second) {
        detail::set(raw_.first_frame.rotation, first);
        detail::set(raw_.second_frame.rotation, second);
        return *this;
    }

    JointDesc& limit(std::size_t axis, float least, float most) {
        raw_.limited_axes |= bit(axis);
        raw_.least[axis] = least;
        raw_.most[axis] = most;
        return *this;
    }

    JointDesc& motor(std::size_t axis, const Motor& motor) {
        raw_.motor_axes |= bit(axis);
        raw_.motor_position[axis] = motor.position;
        raw_.motor_velocity[axis] = motor.velocity;
        raw_.motor_stiffness[axis] = motor.stiffness;
        raw_.motor_damping[axis] = motor.damping;
        if (motor.force) {
            raw_.motor_force[axis] = *motor.force;
        }
        return *this;
    }

    JointDesc& breaks_at(float force, float torque) {
        raw_.has_strength = 1;
        raw_.break_force = force;
        raw_.break_torque = torque;
        return *this;
    }

    /// Every other field, as rhumb.h names it.
    RhumbJointDesc& fields() noexcept { return raw_; }
    const RhumbJointDesc& raw() const noexcept { return raw_; }

private:
    static std::uint32_t bit(std::size_t axis) {
        if (axis >= 6) {
            throw Error(RHUMB_CODE_INVALID, "an axis of a joint must be 0 to 5");
        }
        return 1U << axis;
    }

    RhumbJointDesc raw_;
};

// >>> records, made by bindings/table
/// A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls. Give the
/// coordinates of its scene: what is not set has its default in them.
class Character {
public:
    explicit Character(RhumbCoordinates coordinates = RHUMB_COORDINATES_RHUMB) {
        throw_unless_ok(rhumb_character_init(&raw_, static_cast<std::uint32_t>(coordinates)));
    }

    /// Gap that it keeps to its surroundings, units of length: 0.001 to 10,000 m.
    Character& offset(float offset) {
        raw_.offset = offset;
        return *this;
    }

    /// Steepest slope that it climbs, from level ground: 0 to π/2 rad.
    Character& climb_angle(float climb_angle) {
        raw_.climb_angle = climb_angle;
        return *this;
    }

    /// Slope from which on it slides down, from level ground: 0 to π/2 rad.
    Character& slide_angle(float slide_angle) {
        raw_.slide_angle = slide_angle;
        return *this;
    }

    /// Mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg.
    Character& mass(float mass) {
        raw_.mass = mass;
        return *this;
    }

    /// Direction away from the ground, of unit length, instead of the one against gravity.
    Character& up(Vec3 up) {
        raw_.has_up = 1;
        detail::set(raw_.up, up);
        return *this;
    }

    /// height: greatest height of a step that it climbs, units of length: 0.001 to 10,000 m.
    /// width: free width that it needs on a step, units of length: 0.001 to 10,000 m.
    /// onto_dynamic: it also climbs onto dynamic bodies; otherwise it pushes them.
    Character& step(float height, float width, bool onto_dynamic = false) {
        raw_.has_step = 1;
        raw_.step_height = height;
        raw_.step_width = width;
        raw_.onto_dynamic = onto_dynamic ? 1 : 0;
        return *this;
    }

    /// Greatest drop of the ground that it follows without a fall, units of length: 0.001 to 10,000 m.
    /// None: it has none.
    Character& snap(std::optional<float> snap) {
        raw_.has_snap = snap ? 1 : 0;
        raw_.snap = snap.value_or(0.0F);
        return *this;
    }

    /// Every field, as rhumb.h names it.
    RhumbCharacter& fields() noexcept { return raw_; }
    const RhumbCharacter& raw() const noexcept { return raw_; }

private:
    RhumbCharacter raw_;
};

/// A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring. Give the
/// coordinates of its scene: what is not set has its default in them.
class Wheel {
public:
    /// position: upper end of the suspension, units of length: at most 10,000 m along each axis.
    /// radius: radius of the wheel, units of length: 0.001 to 10,000 m.
    Wheel(Vec3 position, float radius, RhumbCoordinates coordinates = RHUMB_COORDINATES_RHUMB) {
        throw_unless_ok(rhumb_wheel_init(&raw_, static_cast<std::uint32_t>(coordinates)));
        detail::set(raw_.position, position);
        raw_.radius = radius;
    }

    /// Direction of the suspension, of unit length, towards the ground.
    Wheel& direction(Vec3 direction) {
        detail::set(raw_.direction, direction);
        return *this;
    }

    /// Axis about which the wheel turns, of unit length, to the right of the way forward.
    Wheel& axle(Vec3 axle) {
        detail::set(raw_.axle, axle);
        return *this;
    }

    /// Length of the suspension without load, from the position to the wheel's centre, units of length: 0 to 10,000 m.
    Wheel& rest_length(float rest_length) {
        raw_.rest_length = rest_length;
        return *this;
    }

    /// Greatest change of that length, units of length: 0 to 10,000 m.
    Wheel& travel(float travel) {
        raw_.travel = travel;
        return *this;
    }

    /// Acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s².
    Wheel& stiffness(float stiffness) {
        raw_.stiffness = stiffness;
        return *this;
    }

    /// Damping while the spring is compressed: 0 to 1,000,000 1/s.
    Wheel& compression(float compression) {
        raw_.compression = compression;
        return *this;
    }

    /// Damping while the spring relaxes: 0 to 1,000,000 1/s.
    Wheel& relaxation(float relaxation) {
        raw_.relaxation = relaxation;
        return *this;
    }

    /// Greatest force of the suspension, kg times units of length per s²: 0 to 1,000,000,000 N.
    Wheel& force_max(float force_max) {
        raw_.force_max = force_max;
        return *this;
    }

    /// Greatest force along the ground, as a share of the suspension's force, of which the part along the way forward
    /// counts half: 0 to 100.
    Wheel& friction_slip(float friction_slip) {
        raw_.friction_slip = friction_slip;
        return *this;
    }

    /// Factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100.
    Wheel& side_friction(float side_friction) {
        raw_.side_friction = side_friction;
        return *this;
    }

    /// Every field, as rhumb.h names it.
    RhumbWheel& fields() noexcept { return raw_; }
    const RhumbWheel& raw() const noexcept { return raw_; }

private:
    RhumbWheel raw_;
};

/// Steering, force and brake of a wheel. Without any, it rolls freely. See RhumbWheelInput.
using WheelInput = RhumbWheelInput;

// <<< records

/// Commands, for Scene::command.
namespace command {

inline RhumbCommand make(RhumbCommandKind kind, Body body) {
    RhumbCommand command = {};
    command.kind = static_cast<std::uint32_t>(kind);
    command.body = body;
    return command;
}

// >>> commands, made by bindings/table
/// Removes a body, and its joints.
inline RhumbCommand remove_body(Body body) { return make(RHUMB_COMMAND_KIND_REMOVE_BODY, body); }

/// Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick. If poses of a
/// kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next, carries what
/// lies on it, and stops at the last one. A pose that is farther than 100 m/s or a quarter of a turn in a tick from
/// where its motion leads is a jump that shoves nothing. If a velocity is set after the pose, the body is there after
/// one tick and continues at that velocity.
/// position: place of its centre of mass, or of the origin of a hull or compound added here, units of length: at most
/// 100,000 m along each axis.
/// rotation: unit quaternion x, y, z, w, body to world.
inline RhumbCommand set_pose(Body body, Vec3 position, Quat rotation = {0, 0, 0, 1}) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_SET_POSE, body);
    detail::set(command.vector, position);
    detail::set(command.rotation, rotation);
    return command;
}

/// Sets both velocities. A kinematic body keeps them, and a character walks by them.
/// linear: velocity of the centre of mass, units of length per second: at most 1,000 m/s along each axis.
/// angular: angular velocity about world axes: at most 100 rad/s along each axis.
inline RhumbCommand set_velocity(Body body, Vec3 linear, Vec3 angular = {}) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_SET_VELOCITY, body);
    detail::set(command.vector, linear);
    detail::set(command.angular, angular);
    return command;
}

/// Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused.
/// force: in world axes, kg times units of length per s²: at most 1,000,000,000 N along each axis.
inline RhumbCommand force(Body body, Vec3 force) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_FORCE, body);
    detail::set(command.vector, force);
    return command;
}

/// Applies a torque during the next tick; one that makes the body spin too fast is refused.
/// torque: about world axes, kg times units of length² per s²: at most 1,000,000,000 N·m along each axis.
inline RhumbCommand torque(Body body, Vec3 torque) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_TORQUE, body);
    detail::set(command.vector, torque);
    return command;
}

/// Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast is refused.
/// impulse: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each axis.
inline RhumbCommand impulse(Body body, Vec3 impulse) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_IMPULSE, body);
    detail::set(command.vector, impulse);
    return command;
}

/// Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused.
/// impulse: about world axes, kg times units of length² per second: at most 1,000,000,000 N·m·s along each axis.
inline RhumbCommand torque_impulse(Body body, Vec3 impulse) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_TORQUE_IMPULSE, body);
    detail::set(command.vector, impulse);
    return command;
}

/// Changes the gravity of the scene.
/// gravity: in world axes, units of length per s²: at most 1,000 m/s² along each axis.
inline RhumbCommand set_gravity(Vec3 gravity) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_SET_GRAVITY, 0);
    detail::set(command.vector, gravity);
    return command;
}

/// Applies a force at a point during the next tick; one that makes the body too fast is refused.
/// force: in world axes, kg times units of length per s²: at most 1,000,000,000 N along each axis.
/// point: point of the world where it acts, units of length: at most 100,000 m along each axis.
inline RhumbCommand force_at(Body body, Vec3 force, Vec3 point) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_FORCE_AT, body);
    detail::set(command.vector, force);
    detail::set(command.point, point);
    return command;
}

/// Applies an impulse at a point: both velocities change at once; one that makes the body too fast is refused.
/// impulse: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each axis.
/// point: point of the world where it acts, units of length: at most 100,000 m along each axis.
inline RhumbCommand impulse_at(Body body, Vec3 impulse, Vec3 point) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_IMPULSE_AT, body);
    detail::set(command.vector, impulse);
    detail::set(command.point, point);
    return command;
}

/// Puts a dynamic body to sleep, until something that moves touches it.
inline RhumbCommand sleep(Body body) { return make(RHUMB_COMMAND_KIND_SLEEP, body); }

/// Wakes a dynamic body.
inline RhumbCommand wake(Body body) { return make(RHUMB_COMMAND_KIND_WAKE, body); }

/// Turns the events of a body on; what is left out, off. A new body reports none.
/// events: RHUMB_EVENTS_ bits. force: from which on contacts are reported, if that bit is set.
inline RhumbCommand set_events(Body body, std::uint32_t events, float force = 0.0F) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_SET_EVENTS, body);
    command.events = events;
    command.number = force;
    return command;
}

/// Lets a character rise along its direction up. In the air nothing happens, unless it may jump from anywhere.
/// speed: speed with which it rises, units of length per second: -1,000 to 1,000 m/s.
/// from: ground that the jump needs.
inline RhumbCommand jump(Body body, float speed, RhumbJumpFrom from = RHUMB_JUMP_FROM_GROUND) {
    RhumbCommand command = make(RHUMB_COMMAND_KIND_JUMP, body);
    command.number = speed;
    command.choice = static_cast<std::uint32_t>(from);
    return command;
}

// <<< commands

}  // namespace command

/// Queries, for Scene::query.
namespace query {

inline RhumbQuery make(RhumbQueryKind kind, Vec3 position, Vec3 translation = {}) {
    RhumbQuery query;
    throw_unless_ok(rhumb_query_init(&query));
    query.kind = static_cast<std::uint32_t>(kind);
    const float place[] = {position.x, position.y, position.z};
    const float way[] = {translation.x, translation.y, translation.z};
    for (std::size_t i = 0; i < 3; ++i) {
        query.position[i] = place[i];
        query.translation[i] = way[i];
    }
    return query;
}

/// The nearest bodies along a line. One whose surface the line only reaches with its end is not hit.
inline RhumbQuery ray(Vec3 origin, Vec3 translation, std::uint32_t hits = 1) {
    RhumbQuery query = make(RHUMB_QUERY_KIND_RAY, origin, translation);
    query.hits = hits;
    return query;
}

/// The nearest bodies that a shape touches on its way. Simple shapes only, which point to nothing.
inline RhumbQuery shape_cast(const Shape& shape, Vec3 position, Vec3 translation, std::uint32_t hits = 1) {
    RhumbQuery query = make(RHUMB_QUERY_KIND_SHAPE_CAST, position, translation);
    query.shape = shape.raw();
    query.hits = hits;
    return query;
}

/// The bodies whose surfaces are nearest to a point.
inline RhumbQuery projection(Vec3 point, float distance, std::uint32_t hits = 1) {
    RhumbQuery query = make(RHUMB_QUERY_KIND_PROJECTION, point);
    query.distance = distance;
    query.hits = hits;
    return query;
}

/// The bodies that a shape overlaps. Simple shapes only.
inline RhumbQuery overlap(const Shape& shape, Vec3 position, std::uint32_t hits = 64) {
    RhumbQuery query = make(RHUMB_QUERY_KIND_OVERLAP, position);
    query.shape = shape.raw();
    query.hits = hits;
    return query;
}

/// The bodies that touch a body after the last step, the deepest contact first; their points lie on the body.
inline RhumbQuery contacts(Body body, std::uint32_t hits = 64) {
    RhumbQuery query = make(RHUMB_QUERY_KIND_CONTACTS, {});
    query.body = body;
    query.hits = hits;
    return query;
}

}  // namespace query

/// The arrays of a view, valid until the scene computes the next one or closes. See RhumbPoses.
class Poses {
public:
    explicit Poses(const RhumbPoses& raw) noexcept : raw_(raw) {}

    std::uint64_t tick() const noexcept { return raw_.tick; }
    double fraction() const noexcept { return raw_.fraction; }
    std::size_t size() const noexcept { return raw_.count; }
    Slice<Body> bodies() const noexcept { return {raw_.bodies, raw_.count}; }
    Slice<Vec3> positions() const noexcept { return vectors(raw_.positions); }
    Slice<Quat> rotations() const noexcept { return {reinterpret_cast<const Quat*>(raw_.rotations), raw_.count}; }
    Slice<Vec3> linear_velocities() const noexcept { return vectors(raw_.linear_velocities); }
    Slice<Vec3> angular_velocities() const noexcept { return vectors(raw_.angular_velocities); }
    Slice<std::uint8_t> resting() const noexcept { return {raw_.resting, raw_.count}; }
    Slice<std::uint32_t> changed() const noexcept { return {raw_.changed, raw_.changed_count}; }
    Slice<Body> removed() const noexcept { return {raw_.removed, raw_.removed_count}; }

private:
    Slice<Vec3> vectors(const float* numbers) const noexcept { return {reinterpret_cast<const Vec3*>(numbers), raw_.count}; }

    RhumbPoses raw_;
};

/// Bodies that queries found, and the tick whose scene was asked.
struct Hits {
    std::uint64_t tick;
    std::vector<Hit> hits;
};

/// How to join a scene; plain when made.
struct JoinOptions : RhumbJoinOptions {
    JoinOptions() : RhumbJoinOptions() { throw_unless_ok(rhumb_join_options_init(this)); }

    JoinOptions& with_coordinates(RhumbCoordinates choice) {
        coordinates = static_cast<std::uint32_t>(choice);
        return *this;
    }

    JoinOptions& with_condition(RhumbJoinCondition choice) {
        condition = static_cast<std::uint32_t>(choice);
        return *this;
    }

    JoinOptions& with_stepping(RhumbStepping choice) {
        stepping = static_cast<std::uint32_t>(choice);
        return *this;
    }

    JoinOptions& with_refusals(RhumbRefusals choice) {
        refusals = static_cast<std::uint32_t>(choice);
        return *this;
    }

    /// Takes the scene by cells, if its server divides it: Scene::take_cells_around.
    JoinOptions& by_cells() {
        cells = 1;
        return *this;
    }
};

/// How a file is read, and where its bodies are added.
struct LoadOptions {
    /// Where the root or the world of the file begins.
    Vec3 position{0, 0, 0};
    /// The file's axes, its up upward, to the world.
    Quat rotation{0, 0, 0, 1};
    /// Root of a robot: as in the file, fixed, free.
    enum class Base : std::uint32_t { File, Fixed, Free } base = Base::File;
    /// Contacts between parts of one robot: as other programs read the file, or all that no joint connects.
    enum class OwnContacts : std::uint32_t { File, All } own_contacts = OwnContacts::File;
    /// Folders that are searched for package:// names.
    std::vector<std::string> packages;
    /// Of bodies whose file gives shapes but no mass, kg/m³.
    float density = 1000;
    /// Number of the collision group, below 32, that the parts of a robot share.
    std::uint32_t group = 1;
    /// Number of the first joint; none: the least that are free.
    std::optional<std::uint32_t> first_joint;
};

/// Where the file's frame of a body is, from its centre of mass and in its axes.
struct LoadedFrame {
    Vec3 position;
    Quat rotation;
};

/// A file that was added. A name that the file has twice, or not at all, has a number.
struct Loaded {
    std::map<std::string, Body> bodies;
    std::map<std::string, LoadedFrame> frames;
    std::map<std::string, std::uint32_t> joints;
    /// A sentence for each thing that the file says and the scene has not, or has by something near to it.
    std::vector<std::string> left_out;
};

/// The whole state of a scene.
class Checkpoint {
public:
    /// Bytes that are damaged, or of another version, are refused. The checksum finds damage and no malice.
    static Checkpoint read(const std::vector<std::uint8_t>& bytes) {
        RhumbCheckpoint raw = {0};
        throw_unless_ok(rhumb_checkpoint_read(bytes.data(), bytes.size(), &raw));
        return Checkpoint(raw);
    }

    Checkpoint(Checkpoint&& other) noexcept : raw_(std::exchange(other.raw_, RhumbCheckpoint{0})) {}

    Checkpoint& operator=(Checkpoint&& other) noexcept {
        std::swap(raw_, other.raw_);
        return *this;
    }

    Checkpoint(const Checkpoint&) = delete;
    Checkpoint& operator=(const Checkpoint&) = delete;

    ~Checkpoint() {
        // Only a handle that was moved away can fail here.
        static_cast<void>(rhumb_checkpoint_close(raw_));
    }

    /// For a file.
    std::vector<std::uint8_t> bytes() const {
        std::size_t count = 0;
        static_cast<void>(rhumb_checkpoint_bytes(raw_, nullptr, 0, &count));
        std::vector<std::uint8_t> bytes(count);
        throw_unless_ok(rhumb_checkpoint_bytes(raw_, bytes.data(), bytes.size(), &count));
        return bytes;
    }

private:
    friend class Scene;
    friend class LocalServer;
    explicit Checkpoint(RhumbCheckpoint raw) noexcept : raw_(raw) {}

    RhumbCheckpoint raw_;
};

/// States of bodies after a step of the caller's engine, in rows of one order.
struct FedStates {
    /// Each once, in any order.
    std::vector<Body> bodies;
    std::vector<Vec3> positions;
    /// Body to world; none at all: no body is turned.
    std::vector<Quat> rotations;
    /// None at all, and no angular ones: velocities follow from the poses.
    std::vector<Vec3> linear_velocities;
    std::vector<Vec3> angular_velocities;
    /// From 1 on; none: the next one. Up to 600 ticks may be left out.
    std::optional<std::uint64_t> tick;
};

/// A command of another member of a scene that this program feeds.
using Request = RhumbRequest;

/// A client of one scene. Closes when it is destroyed. One thread at a time.
class Scene {
public:
    explicit Scene(RhumbScene raw) noexcept : raw_(raw) {}
    Scene(Scene&& other) noexcept : raw_(std::exchange(other.raw_, RhumbScene{0})) {}

    Scene& operator=(Scene&& other) noexcept {
        if (this != &other) {
            close();
            raw_ = std::exchange(other.raw_, RhumbScene{0});
        }
        return *this;
    }

    Scene(const Scene&) = delete;
    Scene& operator=(const Scene&) = delete;
    ~Scene() { close(); }

    Body add_body(const BodyDesc& body) {
        const RhumbBodyDesc raw = body.raw();
        Body id = 0;
        throw_unless_ok(rhumb_scene_add_bodies(raw_, &raw, 1, &id));
        return id;
    }

    /// In one call; ids in the same order.
    std::vector<Body> add_bodies(const std::vector<BodyDesc>& bodies) {
        std::vector<RhumbBodyDesc> raw;
        raw.reserve(bodies.size());
        for (const BodyDesc& body : bodies) {
            raw.push_back(body.raw());
        }
        std::vector<Body> ids(bodies.size());
        throw_unless_ok(rhumb_scene_add_bodies(raw_, raw.data(), raw.size(), ids.data()));
        return ids;
    }

    /// Queues a command; its number is what events name.
    std::uint64_t command(const RhumbCommand& command) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_command(raw_, &command, 1, &number));
        return number;
    }

    /// Queues commands in one call. If one is wrong, none is queued. No number for no commands.
    std::optional<std::uint64_t> command(const std::vector<RhumbCommand>& commands) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_command(raw_, commands.data(), commands.size(), &number));
        return commands.empty() ? std::nullopt : std::optional<std::uint64_t>(number);
    }

    /// Queues the addition of a joint under a number below 65,536 that no joint of the scene has; returns the command's
    /// number.
    std::uint64_t add_joint(std::uint32_t joint, const JointDesc& desc) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_add_joint(raw_, joint, &desc.raw(), &number));
        return number;
    }

    /// Queues the replacement of a joint, its motors among others.
    std::uint64_t change_joint(std::uint32_t joint, const JointDesc& desc) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_change_joint(raw_, joint, &desc.raw(), &number));
        return number;
    }

    std::uint64_t remove_joint(std::uint32_t joint) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_remove_joint(raw_, joint, &number));
        return number;
    }

    // >>> commands of a scene, made by bindings/table
    /// Makes a character or a vehicle an ordinary body again.
    std::uint64_t clear_locomotion(Body body) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_clear_locomotion(raw_, body, &number));
        return number;
    }

    /// Makes a kinematic body a character, which walks by the velocity that is set, or gives a character other
    /// settings. Events report when it reaches the ground and when it leaves it.
    std::uint64_t set_character(Body body, const Character& character) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_set_character(raw_, body, &character.raw(), &number));
        return number;
    }

    /// Makes a dynamic body a vehicle, whose wheels begin without inputs.
    std::uint64_t set_vehicle(Body body, const std::vector<Wheel>& wheels) {
        std::vector<RhumbWheel> raw;
        raw.reserve(wheels.size());
        for (const Wheel& wheel : wheels) {
            raw.push_back(wheel.raw());
        }
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_set_vehicle(raw_, body, raw.data(), raw.size(), &number));
        return number;
    }

    /// Sets steering, force and brake of all wheels of a vehicle. It keeps them until the next ones.
    /// inputs: in the order of the wheels.
    std::uint64_t set_wheels(Body body, const std::vector<WheelInput>& inputs) {
        std::uint64_t number = 0;
        throw_unless_ok(rhumb_scene_set_wheels(raw_, body, inputs.data(), inputs.size(), &number));
        return number;
    }

    // <<< commands of a scene

    /// Requests authority over kinematic bodies, 256 at most, in place of those of now; none ends it. An event answers. The
    /// tolerance of a stream adds to this one. A second request before the answer throws. For a member by cells, the grant of a
    /// body waits until a cell that it takes has had the body.
    void take_authority(const std::vector<Body>& bodies, double tolerance_m = 0.02) {
        throw_unless_ok(rhumb_scene_take_authority(raw_, bodies.data(), bodies.size(), tolerance_m));
    }

    /// Edges of the scene's cells along x, y and z, 0 along an axis that is not divided. None for a scene that is not divided,
    /// and for one that was joined without `cells`.
    std::optional<Vec3> cell_grid() {
        Vec3 edges{0, 0, 0};
        throw_unless_ok(rhumb_scene_cell_grid(raw_, &edges.x));
        const bool none = edges.x == 0.0F && edges.y == 0.0F && edges.z == 0.0F;
        return none ? std::nullopt : std::optional<Vec3>(edges);
    }

    /// Takes the cells around a point and no others, each by the nearest band that reaches it. Call it as the point moves.
    /// poses() has the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is more than
    /// half of the shortest edge. A radius of 0 takes the cell that has the point.
    void take_cells_around(Vec3 point, const std::vector<RhumbCellBand>& bands) {
        throw_unless_ok(rhumb_scene_take_cells_around(raw_, &point.x, bands.data(), bands.size()));
    }

    /// Takes these cells and no others.
    void take_cells(const std::vector<RhumbCellChoice>& choices) {
        throw_unless_ok(rhumb_scene_take_cells(raw_, choices.data(), choices.size()));
    }

    /// The cells that are taken, and the state of each.
    std::vector<RhumbTakenCell> cells() {
        std::vector<RhumbTakenCell> taken(256);
        std::size_t count = 0;
        throw_unless_ok(rhumb_scene_cells(raw_, taken.data(), taken.size(), &count));
        taken.resize(count);
        return taken;
    }

    /// Publishes the states of all bodies under this client's authority, once per frame; their tick, or none while nothing
    /// is published.
    std::optional<std::uint64_t> publish(const std::vector<RhumbBodyState>& states) {
        std::uint8_t published = 0;
        std::uint64_t tick = 0;
        throw_unless_ok(rhumb_scene_publish(raw_, states.data(), states.size(), &published, &tick));
        return published != 0 ? std::optional<std::uint64_t>(tick) : std::nullopt;
    }

    /// Hands over the states of one tick of a scene that this client feeds, has the scene step, and returns the tick: see
    /// LocalServer::feed. A body that is left out rests where it is. Throws RefusedError for what the scene refused since the
    /// last call, after the states are fed.
    std::uint64_t feed(const FedStates& states) {
        const std::size_t count = states.bodies.size();
        RhumbFedStates raw = {};
        raw.tick = states.tick.value_or(0);
        if (states.tick.has_value() && raw.tick == 0) {
            throw Error(RHUMB_CODE_INVALID, "tick is 0, and must be 1 or later");
        }
        raw.count = count;
        raw.bodies = states.bodies.data();
        raw.positions = rows(states.positions, count, "positions");
        raw.rotations = optional_rows(states.rotations, count, "rotations");
        raw.linear_velocities = optional_rows(states.linear_velocities, count, "linear_velocities");
        raw.angular_velocities = optional_rows(states.angular_velocities, count, "angular_velocities");
        return feed(raw);
    }

    /// The same of arrays that something else owns.
    std::uint64_t feed(const RhumbFedStates& states) {
        std::uint64_t tick = 0;
        throw_unless_done(rhumb_scene_feed(raw_, &states, &tick));
        return tick;
    }

    /// The oldest unread request of another member of a scene that this client feeds. One that moves a body is answered by
    /// what is fed; the others change the scene once they are accepted.
    std::optional<Request> poll_request() {
        Request request = {};
        throw_unless_ok(rhumb_scene_poll_request(raw_, &request));
        const bool none = request.kind == static_cast<std::uint32_t>(RHUMB_REQUEST_KIND_NONE);
        return none ? std::nullopt : std::optional<Request>(request);
    }

    /// Changes the scene as another member asked; that one, and this client by its next feed, is refused after all if the
    /// scene cannot.
    void accept(const Request& request) { throw_unless_ok(rhumb_scene_accept_request(raw_, request.request)); }

    /// Refuses what another member asked for.
    void refuse(const Request& request) { throw_unless_ok(rhumb_scene_refuse_request(raw_, request.request)); }

    /// Queues the removal of the shapes that came with this client's bodies and that no body has any more, and returns their
    /// number.
    std::size_t remove_unused_shapes() {
        std::size_t count = 0;
        throw_unless_ok(rhumb_scene_remove_unused_shapes(raw_, &count));
        return count;
    }

    /// Ticks ahead of the server's clock by which publish is, in place of those of the options.
    void set_lead_ticks(double ticks) { throw_unless_ok(rhumb_scene_set_lead_ticks(raw_, ticks)); }

    void flush() { throw_unless_ok(rhumb_scene_flush(raw_)); }

    /// Steps a lockstep scene once; returns the tick of the view. Throws RefusedError for what the server refused, after the
    /// tick is done.
    std::uint64_t advance(std::uint32_t depth = 0) {
        std::uint64_t tick = 0;
        throw_unless_done(rhumb_scene_advance(raw_, depth, &tick));
        return tick;
    }

    /// Waits for the tick of an advance that timed out.
    std::uint64_t wait(std::uint32_t depth = 0) {
        std::uint64_t tick = 0;
        throw_unless_done(rhumb_scene_wait(raw_, depth, &tick));
        return tick;
    }

    /// Computes the view of a free-running scene for now. Throws RefusedError as advance does.
    Time poll() {
        Time time = {};
        throw_unless_done(rhumb_scene_poll(raw_, &time));
        return time;
    }

    void idle(double seconds) { throw_unless_ok(rhumb_scene_idle(raw_, seconds)); }

    Poses poses() {
        RhumbPoses poses = {};
        throw_unless_ok(rhumb_scene_poses(raw_, &poses));
        return Poses(poses);
    }

    /// Place of a body in the arrays of poses(); none for a body that is not in the view.
    std::optional<std::size_t> place(Body body) {
        std::size_t place = 0;
        const RhumbCode code = rhumb_scene_place(raw_, body, &place);
        if (code == RHUMB_CODE_INVALID) {
            return std::nullopt;
        }
        throw_unless_ok(code);
        return place;
    }

    /// How far any point of a body as the view shows it may be from its true place now; infinite while that is not known.
    float error_bound(Body body) {
        float bound = 0.0F;
        throw_unless_ok(rhumb_scene_error_bounds(raw_, &body, 1, &bound));
        return bound;
    }

    std::vector<float> error_bounds(const std::vector<Body>& bodies) {
        std::vector<float> bounds(bodies.size());
        throw_unless_ok(rhumb_scene_error_bounds(raw_, bodies.data(), bodies.size(), bounds.data()));
        return bounds;
    }

    /// How far any point of a body may be off at a tick by what is known of it, whatever the view shows.
    float tick_error_bound(Body body, std::uint64_t tick) {
        float bound = 0.0F;
        throw_unless_ok(rhumb_scene_tick_error_bounds(raw_, tick, &body, 1, &bound));
        return bound;
    }

    /// The oldest unread event.
    std::optional<Event> poll_event() {
        Event event;
        throw_unless_ok(rhumb_scene_poll_event(raw_, &event));
        const bool none = event.kind == static_cast<std::uint32_t>(RHUMB_EVENT_KIND_NONE);
        return none ? std::nullopt : std::optional<Event>(event);
    }

    Hits query(const std::vector<RhumbQuery>& queries) {
        std::size_t capacity = 0;
        for (const RhumbQuery& query : queries) {
            // A query of more is an error of the call.
            capacity += query.hits < 65 ? query.hits : 65;
        }
        Hits found = {0, std::vector<Hit>(capacity)};
        std::size_t count = 0;
        throw_unless_ok(rhumb_scene_query(raw_, queries.data(), queries.size(), found.hits.data(), capacity, &count, &found.tick));
        found.hits.resize(count);
        return found;
    }

    Statistics statistics() {
        Statistics statistics = {};
        throw_unless_ok(rhumb_scene_statistics(raw_, &statistics));
        return statistics;
    }

    /// Deletes the scene for all of its clients.
    void delete_scene() { throw_unless_ok(rhumb_scene_delete(raw_)); }

    /// Adds a robot or a scene from a file: URDF, MJCF with their meshes, glTF, or Rhumb's JSON. Gravity and ticks are the
    /// scene's.
    Loaded load(const std::string& path, const LoadOptions& options = LoadOptions()) {
        RhumbLoadOptions raw = {};
        throw_unless_ok(rhumb_load_options_init(&raw));
        const float position[3] = {options.position.x, options.position.y, options.position.z};
        const float rotation[4] = {options.rotation.x, options.rotation.y, options.rotation.z, options.rotation.w};
        std::copy(position, position + 3, raw.position);
        std::copy(rotation, rotation + 4, raw.rotation);
        raw.base = static_cast<std::uint32_t>(options.base);
        raw.own_contacts = static_cast<std::uint32_t>(options.own_contacts);
        std::string packages;
        for (const std::string& folder : options.packages) {
            packages += folder + ";";
        }
        raw.packages = c_text(packages, "packages");
        raw.density = options.density;
        raw.group = options.group;
        raw.has_first_joint = options.first_joint.has_value() ? 1 : 0;
        raw.first_joint = options.first_joint.value_or(0);
        RhumbLoaded handle = {0};
        throw_unless_ok(rhumb_scene_load(raw_, c_text(path, "path"), &raw, &handle));
        const auto close = [](const RhumbLoaded* one) { static_cast<void>(rhumb_loaded_close(*one)); };
        const std::unique_ptr<RhumbLoaded, decltype(close)> closed(&handle, close);
        return read(handle);
    }

    /// The address of the page that shows the scene to browsers of this machine. The server must be in this process.
    std::string page() {
        RhumbAddress address = {};
        throw_unless_ok(rhumb_scene_page(raw_, &address));
        return address.text;
    }

    /// The whole state of the scene, with everything that this client has sent: LocalServer::restore makes scenes of it, which
    /// run to the same bits, given the same commands before the same ticks. The server must be in this process, without
    /// sockets.
    Checkpoint save() {
        RhumbCheckpoint raw = {0};
        throw_unless_ok(rhumb_scene_save(raw_, &raw));
        return Checkpoint(raw);
    }

    /// Leaves the scene. A second time does nothing.
    void close() noexcept {
        // Only a handle that is closed already can fail here.
        static_cast<void>(rhumb_scene_close(std::exchange(raw_, RhumbScene{0})));
    }

    /// The handle of rhumb.h, which this object continues to own.
    RhumbScene raw() const noexcept { return raw_; }

private:
    /// Rows as C reads them, one for each of `count` bodies.
    template <typename Row>
    static const float* rows(const std::vector<Row>& given, std::size_t count, const char* what) {
        if (given.size() != count) {
            throw Error(RHUMB_CODE_INVALID,
                std::string(what) + " has " + std::to_string(given.size()) + " rows, and must have " + std::to_string(count)
                    + ": as many as there are bodies");
        }
        return given.empty() ? nullptr : &given.front().x;
    }

    template <typename Row>
    static const float* optional_rows(const std::vector<Row>& given, std::size_t count, const char* what) {
        return given.empty() ? nullptr : rows(given, count, what);
    }

    static Loaded read(RhumbLoaded handle) {
        RhumbLoadedCounts counts = {};
        throw_unless_ok(rhumb_loaded_counts(handle, &counts));
        Loaded loaded;
        for (std::size_t place = 0; place < counts.bodies; ++place) {
            RhumbLoadedBody body = {};
            throw_unless_ok(rhumb_loaded_body(handle, place, &body));
            loaded.bodies[body.name] = body.body;
            const float* at = body.frame_position;
            const float* turned = body.frame_rotation;
            loaded.frames[body.name] = {{at[0], at[1], at[2]}, {turned[0], turned[1], turned[2], turned[3]}};
        }
        for (std::size_t place = 0; place < counts.joints; ++place) {
            RhumbLoadedJoint joint = {};
            throw_unless_ok(rhumb_loaded_joint(handle, place, &joint));
            loaded.joints[joint.name] = joint.joint;
        }
        for (std::size_t place = 0; place < counts.left_out; ++place) {
            RhumbNote note = {};
            throw_unless_ok(rhumb_loaded_note(handle, place, &note));
            loaded.left_out.emplace_back(note.text);
        }
        return loaded;
    }

    /// Throws RefusedError with what the server refused, and Error for anything else that is not right.
    void throw_unless_done(RhumbCode code) {
        if (code != RHUMB_CODE_REFUSED) {
            throw_unless_ok(code);
            return;
        }
        const std::string sentence = rhumb_last_error();
        std::vector<Refusal> refusals;
        RhumbRefusal raw;
        for (throw_unless_ok(rhumb_scene_poll_refusal(raw_, &raw)); raw.exists != 0;
             throw_unless_ok(rhumb_scene_poll_refusal(raw_, &raw))) {
            const auto number = raw.is_command != 0 ? std::optional<std::uint64_t>(raw.number) : std::nullopt;
            refusals.push_back({number, raw.body, raw.reason, raw.text});
        }
        throw RefusedError(sentence, std::move(refusals));
    }

    RhumbScene raw_;
};

/// Which server to trust.
class Trust {
public:
    /// The server whose certificate has this SHA-256, as the server prints it.
    static Trust fingerprint(std::string fingerprint) { return Trust(std::move(fingerprint), std::string()); }

    /// A server whose certificate one of the roots in this PEM file signed.
    static Trust roots(std::string path) { return Trust(std::string(), std::move(path)); }

    /// The server whose fingerprint the address ends with, behind a #.
    static Trust by_address() { return Trust(std::string(), std::string()); }

private:
    friend class Connection;
    Trust(std::string fingerprint, std::string roots) : fingerprint_(std::move(fingerprint)), roots_(std::move(roots)) {}

    std::string fingerprint_;
    std::string roots_;
};

/// A connection to a server that has joined no scene. Closes when it is destroyed.
class Connection {
public:
    /// Connects within the time limit, which holds for every later call that waits. No token for a server without.
    static Connection connect(
        const std::string& address, const Trust& trust, const std::string& token = std::string(), double timeout_s = 5.0) {
        RhumbConnectOptions options = {};
        options.address = c_text(address, "address");
        options.fingerprint = trust.fingerprint_.empty() ? nullptr : c_text(trust.fingerprint_, "fingerprint");
        options.roots = trust.roots_.empty() ? nullptr : c_text(trust.roots_, "roots");
        options.token = token.empty() ? nullptr : c_text(token, "token");
        options.timeout_s = timeout_s;
        RhumbConnection raw = {0};
        throw_unless_ok(rhumb_connect(&options, &raw));
        return Connection(raw);
    }

    /// To a server of its own, in this process and without sockets: it steps within the calls of the scene that is joined.
    static Connection local() {
        RhumbConnection raw = {0};
        throw_unless_ok(rhumb_local(&raw));
        return Connection(raw);
    }

    Connection(Connection&& other) noexcept : raw_(std::exchange(other.raw_, RhumbConnection{0})) {}

    Connection& operator=(Connection&& other) noexcept {
        if (this != &other) {
            close();
            raw_ = std::exchange(other.raw_, RhumbConnection{0});
        }
        return *this;
    }

    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;
    ~Connection() { close(); }

    /// Joins a scene, and uses the connection up; wrong arguments do not.
    Scene join(const std::string& name, const JoinOptions& options = JoinOptions()) {
        RhumbScene scene = {0};
        throw_unless_ok(rhumb_join(raw_, c_text(name, "name"), &options, &scene));
        raw_ = RhumbConnection{0};
        return Scene(scene);
    }

    /// A second time does nothing.
    void close() noexcept {
        // Only a handle that is closed already can fail here.
        static_cast<void>(rhumb_connection_close(std::exchange(raw_, RhumbConnection{0})));
    }

private:
    friend class LocalServer;
    explicit Connection(RhumbConnection raw) noexcept : raw_(raw) {}

    RhumbConnection raw_;
};

/// Where a server in this process steps.
enum class LocalThread : std::uint8_t {
    /// Within the calls of its clients, which take turns if they are on several threads.
    Callers = 0,
    /// On a thread of its own, so that a free-running scene moves on between calls.
    Own = 1,
};

/// A server in this process for several clients. It ends with the last of its connections and scenes.
class LocalServer {
public:
    explicit LocalServer(LocalThread thread = LocalThread::Callers) : raw_{0} {
        throw_unless_ok(rhumb_local_server_open(static_cast<std::uint8_t>(thread), &raw_));
    }

    LocalServer(LocalServer&& other) noexcept : raw_(std::exchange(other.raw_, RhumbLocalServer{0})) {}

    LocalServer& operator=(LocalServer&& other) noexcept {
        if (this != &other) {
            close();
            raw_ = std::exchange(other.raw_, RhumbLocalServer{0});
        }
        return *this;
    }

    LocalServer(const LocalServer&) = delete;
    LocalServer& operator=(const LocalServer&) = delete;
    ~LocalServer() { close(); }

    /// A server that other processes join too, by address(). It has threads of its own. `listen`: IP address and port; port 0
    /// is a free one. There are no tokens: an address that other machines reach must be meant to be open.
    static LocalServer serve(const std::string& listen = "127.0.0.1:0", bool open_to_network = false) {
        RhumbLocalServer raw = {0};
        throw_unless_ok(rhumb_serve(c_text(listen, "listen"), open_to_network ? 1 : 0, &raw));
        return LocalServer(raw);
    }

    /// The one text by which other processes connect, with Trust::by_address(). Empty for a server without sockets.
    std::string address() const {
        RhumbAddress address = {};
        throw_unless_ok(rhumb_local_server_address(raw_, &address));
        return address.text;
    }

    /// Connects one more client. The time limit holds for every later call that waits.
    Connection connect(double timeout_s = 5.0) const {
        RhumbConnection raw = {0};
        throw_unless_ok(rhumb_local_server_connect(raw_, timeout_s, &raw));
        return Connection(raw);
    }

    /// A server of a scene that this program feeds, by this name, and that other processes join: see feed.
    static LocalServer serve_fed(
        const std::string& name, const std::string& listen = "127.0.0.1:0", bool open_to_network = false) {
        RhumbLocalServer raw = {0};
        throw_unless_ok(rhumb_serve_fed(c_text(name, "name"), c_text(listen, "listen"), open_to_network ? 1 : 0, &raw));
        return LocalServer(raw);
    }

    /// Connects the client that will feed a scene: one whose engine is this program's. It makes the scene when it joins by this
    /// name, adds bodies, and hands their states over by Scene::feed. The scene ends with it.
    Connection feed(const std::string& name, double timeout_s = 5.0) const {
        RhumbConnection raw = {0};
        throw_unless_ok(rhumb_local_server_feed(raw_, c_text(name, "name"), timeout_s, &raw));
        return Connection(raw);
    }

    /// Makes a scene that continues from a checkpoint, to be joined by its name. Bodies keep their ids. The scene has no members
    /// at first: it ends if none joins for ten minutes.
    void restore(const std::string& scene, const Checkpoint& checkpoint) {
        throw_unless_ok(rhumb_local_server_restore(raw_, c_text(scene, "scene"), checkpoint.raw_));
    }

    /// Its connections and scenes stay. A second time does nothing.
    void close() noexcept {
        // Only a handle that is closed already can fail here.
        static_cast<void>(rhumb_local_server_close(std::exchange(raw_, RhumbLocalServer{0})));
    }

private:
    explicit LocalServer(RhumbLocalServer raw) noexcept : raw_(raw) {}

    RhumbLocalServer raw_;
};

}  // namespace rhumb

#endif  // RHUMB_HPP
