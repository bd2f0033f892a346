// The script that every language runs; it prints the hash of all poses.
//
// Arguments: the server's address and fingerprint. tests/tests/processes/bindings/script.rs is the same script in Rust.

#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <vector>

#include "rhumb.hpp"

namespace {

constexpr int PILED = 60;
constexpr int TICKS = 150;
constexpr std::uint32_t HINGE = 7;

/// FNV-1a of 64 bits.
class Fnv {
public:
    void fold(float number) {
        std::uint32_t bits;
        std::memcpy(&bits, &number, sizeof bits);
        for (int byte = 0; byte < 4; ++byte) {
            hash_ = (hash_ ^ ((bits >> (8 * byte)) & 0xff)) * 0x100000001b3U;
        }
    }

    unsigned long long value() const { return hash_; }

private:
    std::uint64_t hash_ = 0xcbf29ce484222325U;
};

rhumb::Shape shape(int i) {
    switch (i % 5) {
    case 0:
        return rhumb::Shape::ball(0.25F);
    case 1:
        return rhumb::Shape::cuboid(0.5F, 0.25F, 0.5F);
    case 2:
        return rhumb::Shape::capsule(0.5F, 0.25F);
    case 3:
        return rhumb::Shape::cylinder(0.5F, 0.25F);
    default:
        return rhumb::Shape::cone(0.5F, 0.25F);
    }
}

rhumb::BodyDesc piled(int i) {
    const float x = static_cast<float>(i % 2) * 1.25F - 0.625F;
    const float y = 1.0F + 1.5F * static_cast<float>(i / 4);
    const float z = static_cast<float>(i / 2 % 2) * 1.25F - 0.625F;
    return rhumb::BodyDesc::dynamic(shape(i)).at(x, y, z).angular_velocity({0, 0.5F * static_cast<float>(i % 3), 0});
}

/// A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car.
std::vector<rhumb::BodyDesc> built() {
    const auto ball = rhumb::Shape::ball(0.25F);
    const auto dumbbell = rhumb::Shape::compound({
        {ball, {-0.5F, 0, 0}},
        {ball, {0.5F, 0, 0}},
        {rhumb::Shape::cuboid(0.125F, 0.5F, 0.25F), {0, 0, 0.25F}, {0.5F, 0.5F, 0.5F, 0.5F}},
    });
    return {
        rhumb::BodyDesc::dynamic(dumbbell).at(-4, 2, 0),
        rhumb::BodyDesc::fixed(rhumb::Shape::cuboid(0.25F, 0.25F, 0.25F)).at(4, 4, 0),
        rhumb::BodyDesc::dynamic(rhumb::Shape::cuboid(0.25F, 1, 0.25F)).at(4, 2.5F, 0),
        rhumb::BodyDesc::kinematic(rhumb::Shape::capsule(0.5F, 0.25F)).at(7, 1, 3),
        rhumb::BodyDesc::dynamic(rhumb::Shape::cuboid(0.75F, 0.25F, 1.5F)).at(-7, 1, 5),
    };
}

/// Lets the walker walk and the car roll.
void set_moving(rhumb::Scene& scene, const std::vector<rhumb::Body>& bodies) {
    scene.set_character(bodies[PILED + 4], rhumb::Character().step(0.5F, 0.125F));
    scene.command(rhumb::command::set_velocity(bodies[PILED + 4], {-1, 0, -0.5F}, {}));
    std::vector<rhumb::Wheel> wheels;
    for (const float z : {-1.25F, 1.25F}) {
        for (const float x : {-0.75F, 0.75F}) {
            wheels.emplace_back(rhumb::Vec3{x, -0.125F, z}, 0.25F);
        }
    }
    scene.set_vehicle(bodies[PILED + 5], wheels);
}

rhumb::JointDesc hinge(const std::vector<rhumb::Body>& bodies, const rhumb::Motor& motor) {
    return rhumb::JointDesc(RHUMB_JOINT_KIND_REVOLUTE, bodies[PILED + 2], bodies[PILED + 3])
        .anchors({0, -0.5F, 0}, {0, 1, 0})
        .limit(3, -0.5F, 1)
        .motor(3, motor);
}

void interfere(rhumb::Scene& scene, int tick, const std::vector<rhumb::Body>& bodies) {
    if (tick == 20) {
        const rhumb::WheelInput front = {0.25F, 0, 0}, rear = {0, 2000, 0};
        scene.set_wheels(bodies[PILED + 5], {front, front, rear, rear});
    } else if (tick == 30) {
        scene.command({rhumb::command::impulse(bodies[1], {200, 100, 0}),
                       rhumb::command::set_velocity(bodies[6], {0, 4, 1}, {1, 0, 0})});
    } else if (tick == 40) {
        scene.command(rhumb::command::jump(bodies[PILED + 4], 4));
    } else if (tick == 60) {
        scene.command(rhumb::command::remove_body(bodies[4]));
        if (scene.remove_unused_shapes() != 0) {
            throw std::runtime_error("the other cones have the shape");
        }
    } else if (tick == 75) {
        scene.change_joint(HINGE, hinge(bodies, {0.75F, 0, 30, 5}));
    } else if (tick == 90) {
        scene.command(rhumb::command::set_gravity({1, -9.75F, 0}));
    }
}

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3) {
        return 2;
    }
    const auto trust = rhumb::Trust::fingerprint(arguments[2]);
    auto connection = rhumb::Connection::connect(arguments[1], trust, "", 30);
    auto scene = connection.join("script", rhumb::JoinOptions().with_condition(RHUMB_JOIN_CONDITION_CREATE));

    std::vector<rhumb::BodyDesc> descs;
    descs.push_back(rhumb::BodyDesc::fixed(rhumb::Shape::cuboid(10, 0.5F, 10)).at(0, -0.5F, 0));
    for (int i = 0; i < PILED; ++i) {
        descs.push_back(piled(i));
    }
    for (const auto& desc : built()) {
        descs.push_back(desc);
    }
    const auto bodies = scene.add_bodies(descs);
    scene.add_joint(HINGE, hinge(bodies, {0, 1, 0, 4, 2000.0F}));
    set_moving(scene, bodies);
    for (int tick = 0; tick < TICKS; ++tick) {
        interfere(scene, tick, bodies);
        scene.advance();
    }

    Fnv hash;
    const auto poses = scene.poses();
    for (const auto body : bodies) {
        const auto place = scene.place(body);
        if (!place) {
            continue;
        }
        const auto at = poses.positions()[*place];
        const auto turned = poses.rotations()[*place];
        for (const float number : {at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w}) {
            hash.fold(number);
        }
    }
    const auto found = scene.query({rhumb::query::ray({-0.625F, 50, -0.625F}, {0, -100, 0}, 8)});
    for (const auto& hit : found.hits) {
        hash.fold(hit.distance);
    }
    std::printf("%zu bodies, %zu hits, hash %016llx\n", poses.size(), found.hits.size(), hash.value());
    scene.delete_scene();
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
