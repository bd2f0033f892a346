// A character and a vehicle of the C++ header, in Unreal's axes.
//
// Arguments: the server's address and fingerprint.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <vector>

#include "rhumb.hpp"

namespace {

constexpr RhumbCoordinates UNREAL = RHUMB_COORDINATES_UNREAL;

void expect_near(float got, float expected, float within, const char* what) {
    if (!(std::fabs(got - expected) <= within)) {
        std::fprintf(stderr, "%s is %f and not %f\n", what, static_cast<double>(got), static_cast<double>(expected));
        std::exit(1);
    }
}

void advance(rhumb::Scene& scene, int ticks) {
    for (int tick = 0; tick < ticks; ++tick) {
        scene.advance();
    }
}

rhumb::Vec3 position(rhumb::Scene& scene, rhumb::Body body) {
    return scene.poses().positions()[scene.place(body).value()];
}

/// Events of this kind about the body since the last call.
int count(rhumb::Scene& scene, RhumbEventKind kind, rhumb::Body body) {
    int found = 0;
    while (const auto event = scene.poll_event()) {
        if (event->kind == RHUMB_EVENT_KIND_COMMAND_REFUSED) {
            std::fprintf(stderr, "refused: %s\n", event->text);
            std::exit(1);
        }
        found += event->kind == static_cast<std::uint32_t>(kind) && event->body == body ? 1 : 0;
    }
    return found;
}

void character(rhumb::Scene& scene) {
    scene.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::cuboid(100, 200, 10)).at(300, 0, 10));
    const auto body = scene.add_body(rhumb::BodyDesc::kinematic(rhumb::Shape::capsule(60, 30)).at(0, 0, 92));
    scene.set_character(body, rhumb::Character(UNREAL).up({0, 0, 1}).climb_angle(0.8F).slide_angle(0.8F).mass(70).step(30, 10));
    scene.command(rhumb::command::set_velocity(body, {200, 0, 0}, {}));
    advance(scene, 80);
    expect_near(position(scene, body).x, 267, 35, "the way of the character");
    expect_near(position(scene, body).z, 112, 8, "its height on the step");
    // On the floor, and again on the step.
    expect_near(static_cast<float>(count(scene, RHUMB_EVENT_KIND_REACHED_GROUND, body)), 2, 1, "its landings");
    scene.command(rhumb::command::set_velocity(body, {}, {}));
    scene.command(rhumb::command::jump(body, 500));
    advance(scene, 30);
    // Half a second at 10 m/s² reaches 1.25 m.
    expect_near(position(scene, body).z, 112 + 125, 12, "its jump");
    scene.command(rhumb::command::jump(body, 500, RHUMB_JUMP_FROM_ANYWHERE));
    advance(scene, 10);
    expect_near(position(scene, body).z, 112 + 125 + 70, 16, "its jump in the air");
    scene.clear_locomotion(body);
    advance(scene, 1);
}

void vehicle(rhumb::Scene& scene) {
    const auto chassis = rhumb::BodyDesc::dynamic(rhumb::Shape::cuboid(160, 80, 20)).mass(1000).at(0, 2000, 70);
    const auto body = scene.add_body(chassis);
    std::vector<rhumb::Wheel> wheels;
    for (const float x : {120.0F, -120.0F}) {
        for (const float y : {-80.0F, 80.0F}) {
            wheels.push_back(rhumb::Wheel({x, y, -10}, 30, UNREAL).stiffness(50).compression(5).relaxation(5).rest_length(30).travel(25));
        }
    }
    // The same axes again, by hand.
    wheels[0].direction({0, 0, -1}).axle({0, 1, 0}).fields().friction_slip = 2;
    scene.set_vehicle(body, wheels);
    advance(scene, 60);
    // Two kilonewtons, in kg cm/s², by the rear wheels; the front ones steer to the right a little.
    const rhumb::WheelInput rear = {0, 100'000, 0}, front = {0.1F, 0, 0};
    scene.set_wheels(body, {front, front, rear, rear});
    advance(scene, 90);
    const auto at = position(scene, body);
    expect_near(at.x, 225, 60, "the way of the vehicle");
    expect_near(at.z, 65, 10, "its height");
    if (at.y < 2005) {
        std::fprintf(stderr, "it did not steer to the right: %f\n", static_cast<double>(at.y));
        std::exit(1);
    }
    count(scene, RHUMB_EVENT_KIND_NONE, body);
}

template <typename Call>
void expect_invalid(const char* what, Call call) {
    try {
        call();
    } catch (const rhumb::Error& error) {
        expect_near(static_cast<float>(error.code()), RHUMB_CODE_INVALID, 0, what);
        return;
    }
    std::fprintf(stderr, "no error: %s\n", what);
    std::exit(1);
}

void misuse(rhumb::Scene& scene) {
    const rhumb::Body body = 1;
    expect_invalid("coordinates", [] { rhumb::Character(static_cast<RhumbCoordinates>(4)); });
    expect_invalid("a step", [&] { scene.set_character(body, rhumb::Character().step(-1, 1)); });
    expect_invalid("no wheels", [&] { scene.set_vehicle(body, {}); });
    expect_invalid("no radius", [&] { scene.set_vehicle(body, {rhumb::Wheel({0, 0, 0}, 0)}); });
    expect_invalid("no inputs", [&] { scene.set_wheels(body, {}); });
    expect_invalid("a speed", [&] { scene.command(rhumb::command::jump(body, std::nanf(""))); });
    expect_invalid("no body", [&] { scene.clear_locomotion(0); });
}

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3) {
        return 2;
    }
    const auto trust = rhumb::Trust::fingerprint(arguments[2]);
    auto scene = rhumb::Connection::connect(arguments[1], trust, "", 30)
                     .join("locomotion-cpp", rhumb::JoinOptions().with_coordinates(UNREAL));
    scene.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::cuboid(5000, 5000, 50)).at(0, 0, -50));
    character(scene);
    vehicle(scene);
    misuse(scene);
    scene.delete_scene();
    std::puts("the character walked and the vehicle drove");
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
