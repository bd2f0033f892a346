// Drops a ball on a floor, and prints its position and its error bound.
//
// Without arguments, the physics is in this process. With the address and the fingerprint that `rhumb-server --open` prints,
// it is on that server.

#include <cstdio>
#include <exception>

#include "rhumb.hpp"

int main(int count, char** arguments) try {
    if (count != 1 && count != 3) {
        std::fprintf(stderr, "the server's host:port and its fingerprint, or neither\n");
        return 1;
    }
    auto connection = count == 1 ? rhumb::Connection::local()
                                 : rhumb::Connection::connect(arguments[1], rhumb::Trust::fingerprint(arguments[2]));
    auto scene = connection.join("drop");
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
