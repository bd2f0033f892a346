// Drops a ball on a floor, and prints its position and its error bound.
//
// Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments.

#include <cstdio>
#include <exception>

#include "rhumb.hpp"

int main(int count, char** arguments) try {
    if (count != 3) {
        std::fprintf(stderr, "the server's host:port and its fingerprint are missing\n");
        return 1;
    }
    auto trust = rhumb::Trust::fingerprint(arguments[2]);
    auto scene = rhumb::Connection::connect(arguments[1], trust).join("drop");
    scene.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::cuboid(10, 0.5, 10)).at(0, -0.5, 0));
    auto ball = scene.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)).at(0, 10, 0));
    for (int i = 0; i < 180; ++i) {
        auto tick = scene.advance();
        auto at = scene.poses().positions()[scene.place(ball).value()];
        std::printf("tick %llu: %.3f %.3f %.3f, within %.3f m\n", static_cast<unsigned long long>(tick), at.x, at.y, at.z,
                    scene.error_bound(ball));
    }
    scene.delete_scene();
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
