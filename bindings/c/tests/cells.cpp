// A member by cells, in C++.
//
// Arguments: address and fingerprint of a server that divides its scenes into columns of ten metres.

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "rhumb.hpp"

static void expect(bool holds, const char* what) {
    if (!holds) {
        std::fprintf(stderr, "does not hold: %s\n", what);
        std::exit(1);
    }
}

static bool is_awaited(const RhumbTakenCell& cell) { return cell.state == RHUMB_CELL_STATE_AWAITED; }

int main(int argc, char** argv) {
    expect(argc == 3, "address and fingerprint are given");
    const auto connect = [&] { return rhumb::Connection::connect(argv[1], rhumb::Trust::fingerprint(argv[2]), "", 30); };
    auto owner = connect().join("around");
    const auto near = owner.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::ball(0.5)).at(5, 5, 5));
    const auto away = owner.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::ball(0.5)).at(95, 5, 5));
    owner.advance();
    auto walker = connect().join("around", rhumb::JoinOptions().by_cells());
    expect(!owner.cell_grid().has_value(), "the owner has the whole scene");
    const auto grid = walker.cell_grid();
    expect(grid.has_value() && grid->x == 10 && grid->y == 0 && grid->z == 10, "columns of ten metres");
    const auto arrive = [&] {
        auto cells = walker.cells();
        while (std::any_of(cells.begin(), cells.end(), is_awaited)) {
            walker.advance();
            cells = walker.cells();
        }
    };
    walker.take_cells_around({0, 0, 0}, {{15, 0.02}});
    arrive();
    expect(walker.place(near).has_value() && !walker.place(away).has_value(), "the near one alone is shown");
    expect(walker.error_bound(near) <= 0.0201F, "within the tolerance of its cell");
    walker.take_cells({{{9, 0, 0}, 0.1}});
    arrive();
    expect(walker.poses().size() == 1 && walker.place(away).has_value(), "the other one alone is shown");
    try {
        owner.take_cells({});
        expect(false, "a whole scene has no cells");
    } catch (const rhumb::Error& error) {
        expect(error.code() == RHUMB_CODE_INVALID, error.what());
    }
    std::printf("the cells around were shown\n");
    return 0;
}
