// Random and hostile joints and boxes through box_loop.hpp: it ends, stays inside its memory, and bounds arg L of nothing that is not
// finite. Prints how many of the ordinary boxes are bounded, of how many, and how many members of random discs leave what is computed.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/box_loop.hpp"

using gainroom::BoxLoop;
using gainroom::kQuantities;

struct Given {
    BoxLoop loop{};
    double low[gainroom::kBoxParameters], high[gainroom::kBoxParameters];
    bool scaled;

    bool bounded() const {
        const gainroom::Sector found = loop.at(low, high, scaled);
        return found.phase_high - found.phase_low < 6.0;
    }
};

static Given draw(std::mt19937& engine, int number) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    const double infinite = std::numeric_limits<double>::infinity();
    Given given;
    BoxLoop& loop = given.loop;
    const double values[] = {2e-3, 4e3 + 6e3 * uniform(engine), 0.2 + uniform(engine), 0.1 + uniform(engine), uniform(engine)};
    std::copy(values, values + kQuantities, loop.values);
    loop.motor_side = number % 3 != 0;
    if (number % 5 == 0) loop.values[gainroom::kStiffness] = infinite;
    else if (number % 5 == 1 && loop.motor_side) loop.values[gainroom::kLinkInertia] = infinite;
    int column = 0;
    for (int k = 0; k < kQuantities; k++) {
        const bool felt = std::isfinite(loop.values[k]) && !(number % 5 == 0 && k == gainroom::kDamping);  // a rigid joint has no damper
        if (felt && uniform(engine) < 0.6) loop.columns[k] = ++column;
    }
    if (number % 2 == 0) loop.motor_viscous = uniform(engine), loop.link_viscous = uniform(engine);
    loop.sample_time = number % 4 < 2 ? 5e-4 : 0.0;
    loop.aliases = loop.sample_time > 0 ? 3 : 0;
    loop.rest = 1e-12;
    loop.currents = {{}, {{-3000, 1000}, {-3000, -1000}}, 1e7};
    loop.control = {{{-20, 0}}, {{-1900, 0}}, 1e4};
    given.scaled = number % 5 != 0 && uniform(engine) < 0.5;
    given.low[0] = given.scaled ? 0.2 + 0.5 * uniform(engine) : 20 + 500 * uniform(engine);
    given.high[0] = given.low[0] * 1.001;
    for (int k = 0; k < kQuantities; k++) {
        if (!loop.columns[k]) continue;
        given.low[loop.columns[k]] = loop.values[k];
        given.high[loop.columns[k]] = loop.values[k] * (1 + 1e-3 * uniform(engine));
    }
    return given;
}

using gainroom::Complex;
using gainroom::ComplexDisc;
using gainroom::Disc;

static bool outside(double value, const Disc& disc) { return std::fabs(value - disc.mid) > disc.rad * (1 + 1e-12) + 1e-12; }
static bool outside(Complex value, const ComplexDisc& disc) {
    return std::abs(value - disc.mid) > disc.rad * (1 + 1e-12) + 1e-12 || std::fabs(std::abs(disc.mid) - disc.size) > 1e-12 * disc.size;
}

// Sums, products, inverses, roots and turns of members on the edges of discs that do not hold 0.
static int members_outside(std::mt19937& engine) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    int wrong = 0;
    for (int number = 0; number < 3000; number++) {
        const Disc a{0.5 + uniform(engine), 0.4 * uniform(engine)}, b{0.5 + uniform(engine), 0.4 * uniform(engine)};
        const auto x = number % 2 ? -1.0 * a : a;
        const double sign = number % 2 ? -1.0 : 1.0, edge = number % 4 < 2 ? 1.0 : -1.0, other = number % 8 < 4 ? 1.0 : -1.0;
        const double u = sign * (a.mid + edge * a.rad), v = b.mid + other * b.rad;
        wrong += outside(u + v, x + b) + outside(u * v, x * b) + outside(1 / u, gainroom::inverse(x)) + outside(u + 2, 2.0 + x);
        wrong += outside(std::sqrt(v), gainroom::root(b));
        const Complex corner = std::polar(1.0, 2 * gainroom::kPi * uniform(engine)), far = std::polar(1.0, 7 * uniform(engine));
        const ComplexDisc c = ComplexDisc::around(corner, a.rad), d = ComplexDisc::around(1.5 * far, 3 * b.rad);
        const Complex w = c.mid + std::polar(c.rad, 7 * uniform(engine)), z = d.mid + std::polar(d.rad, 7 * uniform(engine));
        wrong += outside(w * z, times(c, d)) + outside(u * w, times(x, c)) + outside(1.0 / w, gainroom::inverse(c));
        wrong += outside(1.0 / z, gainroom::inverse(d)) + outside(Complex(u, v), joined(x, b)) + outside(Complex(2, v), joined(2.0, b));
        const Disc angle{6 * uniform(engine), 8 * b.rad};
        wrong += outside(std::polar(1.0, angle.mid + other * angle.rad), turned(std::polar(1.0, angle.mid), angle));
    }
    return wrong;
}

int main() {
    std::mt19937 engine(1);
    const double infinite = std::numeric_limits<double>::infinity(), nan = std::numeric_limits<double>::quiet_NaN();
    const double odd[] = {0.0, -1.0, 1e300, -1e300, 5e-324, infinite, -infinite, nan};
    int ordinary = 0, all = 0;
    for (int number = 0; number < 400; number++) {
        const Given given = draw(engine, number);
        all++;
        ordinary += given.bounded();
        for (const double value : odd) {
            const bool finite = std::isfinite(value);
            for (int place = 0; place < given.loop.width(); place++) {
                Given other = given;
                other.low[place] = value;
                if (other.bounded() && !finite) return 1;
                other = given;
                other.high[place] = value;
                if (other.bounded() && !finite) return 2;
            }
            for (int place = 0; place < 6; place++) {
                Given other = given;
                if (place == 0) other.loop.currents.gain = value;
                if (place == 1) other.loop.currents.poles[0] = {value, 0.0};
                if (place == 2) other.loop.control.gain = value;
                if (place == 3) other.loop.control.zeros[0] = {0.0, value};
                if (place == 4) other.loop.control.poles[0] = {value, value};
                if (place == 5) other.loop.control_delay = value;
                if (other.bounded() && !finite) return 3;
            }
            for (int place = 0; place < kQuantities + 4; place++) {  // infinite inertia and stiffness are ordinary ones
                Given other = given;
                if (place < kQuantities) other.loop.values[place] = value;
                if (place == kQuantities) other.loop.motor_viscous = value;
                if (place == kQuantities + 1) other.loop.link_viscous = value;
                if (place == kQuantities + 2) other.loop.sample_time = value;
                if (place == kQuantities + 3) other.loop.rest = value;
                other.bounded();
            }
        }
    }
    std::printf("%d %d %d\n", ordinary, all, members_outside(engine));
}
