// The Unreal code of the book, with stand-ins for the engine's types.
//
// Arguments: the server's address and fingerprint. The test writes the book's code to book.hpp.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>

// Unreal defines these before any other header is read.
#define check(condition) static_assert(false, "a macro of Unreal")
#define verify(condition) static_assert(false, "a macro of Unreal")
#define ensure(condition) static_assert(false, "a macro of Unreal")

struct FVector {
    double X, Y, Z;
    FVector(double x, double y, double z) : X(x), Y(y), Z(z) {}
};

struct FQuat {
    double X, Y, Z, W;
    FQuat(double x, double y, double z, double w) : X(x), Y(y), Z(z), W(w) {}
};

class USceneComponent {
public:
    explicit USceneComponent(FVector location) : Location(location), Rotation(0, 0, 0, 1) {}
    FVector GetComponentLocation() const { return Location; }
    FQuat GetComponentQuat() const { return Rotation; }

    void SetWorldLocationAndRotation(FVector location, FQuat rotation) {
        Location = location;
        Rotation = rotation;
    }

private:
    FVector Location;
    FQuat Rotation;
};

#include "book.hpp"

namespace {

void expect_near(double got, double expected, double within, const char* what) {
    if (!(std::fabs(got - expected) <= within)) {
        std::fprintf(stderr, "%s is %f and not %f\n", what, got, expected);
        std::exit(1);
    }
}

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3) {
        return 2;
    }
    FRhumbWorld world(arguments[1], arguments[2]);
    // One metre forward, two to the right, twelve up.
    USceneComponent crate(FVector(100, 200, 1200));
    const auto body = world.Add(&crate, rhumb::BodyDesc::dynamic(rhumb::Shape::cuboid(50, 20, 10)));
    world.SetVelocity(body, FVector(0, 100, 0), FVector(0, 0, 1));
    for (int tick = 0; tick < 60; ++tick) {
        world.Tick();
    }
    const FVector at = crate.GetComponentLocation();
    expect_near(at.X, 100, 6, "forward");
    expect_near(at.Y, 300, 6, "right");
    // g / 2 of a second's fall, and what the engine's steps add.
    expect_near(at.Z, 1200 - 490, 10, "up");
    // Unreal's yaw of one radian: forward turns to the right.
    const FQuat turned = crate.GetComponentQuat();
    expect_near(turned.Z, std::sin(0.5), 0.1, "yaw, z");
    expect_near(turned.W, std::cos(0.5), 0.1, "yaw, w");

    // The same body in Rhumb's own axes: forward, up, right.
    const auto trust = rhumb::Trust::fingerprint(arguments[2]);
    auto scene = rhumb::Connection::connect(arguments[1], trust)
                     .join("unreal", rhumb::JoinOptions().with_condition(RHUMB_JOIN_CONDITION_JOIN));
    const auto poses = scene.poses();
    const auto place = scene.place(body).value();
    expect_near(poses.positions()[place].x, at.X / 100, 0.11, "x");
    expect_near(poses.positions()[place].y, at.Z / 100, 0.11, "y");
    expect_near(poses.positions()[place].z, at.Y / 100, 0.11, "z");
    scene.delete_scene();
    std::puts("the crate fell and turned as in Unreal");
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
