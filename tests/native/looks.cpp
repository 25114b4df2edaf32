// Random and hostile coupled loops through loop_samples.hpp and loop_curves.hpp: it ends, and stays inside its memory. Prints how many of
// the ordinary ones were followed.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/loop_curves.hpp"

using gainroom::DirectedGains;
using gainroom::DirectedLoop;

static DirectedLoop draw(std::mt19937& engine, std::size_t n, std::size_t m, bool gravity, bool contacts, bool sampled) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    const auto many = [&](std::size_t count, double low, double high) {
        std::vector<double> found(count);
        for (double& value : found) value = low + (high - low) * uniform(engine);
        return found;
    };
    DirectedLoop loop;
    gainroom::Actuated& to = loop.actuated;
    to.size = n;
    loop.directions = m;
    loop.cascade.assign(m, m % 2 == 0 ? 1 : 0);
    if (m != n) {
        loop.torque = many(n * m, -1, 1);
        loop.jacobian = many(m * n, -1, 1);
    }
    to.mobility.assign(n * n, 0.1);
    for (std::size_t i = 0; i < n; i++) to.mobility[i * n + i] = 1 + uniform(engine);
    to.root.assign(n * n, 0.0);
    for (std::size_t i = 0; i < n; i++) to.root[i * n + i] = 1.0;
    to.motor_inertia = many(n, 0.1, 1);
    to.stiffness = many(n, 2e3, 3e4);
    to.stiffness[0] = std::numeric_limits<double>::infinity();
    to.damping = many(n, 0.1, 5);
    to.motor_viscous = many(n, 0, 1);
    to.link_viscous = many(n, 0, 1);
    to.loaded = true;
    if (gravity) to.gravity = many(n * n, -20, 20);
    if (contacts) {
        to.hung = many(2 * n, -0.3, 0.3);
        to.contact_stiffness = many(2, 1e4, 1e5);
        to.contact_damping = many(2, 1, 100);
    }
    to.bandwidth = many(n, 2000, 5000);
    to.damping_ratio = many(n, 0.7, 1);
    to.delay = many(n, 1e-3, 4e-3);
    if (sampled) {
        to.step = 1e-3;
        loop.last = gainroom::kPi / to.step;
        const std::size_t order = 2 * n;
        std::vector<double> a(order * order, 0.0);
        for (std::size_t k = 0; k < order; k++) a[k * order + k] = -1 - 300 * uniform(engine);
        for (std::size_t k = 0; k + 1 < order; k++) a[(k + 1) * order + k] = uniform(engine);
        to.whole = to.hessenberg = {a, many(order * n, -1, 1), many(n * order, -1, 1)};
        to.fast = 10.0;
    }
    loop.velocity = {{1.0, 0.0}, {1e-3, 1.0}};
    loop.integrator = {{1.0}, {1.0, 0.0}};
    loop.shaping = {{}, {}, 1.0};
    loop.settles = gravity ? 1e-6 : 0.0;
    const double last = sampled ? loop.last : 3e4;
    for (int k = 0; k <= 60; k++) loop.grid.push_back(std::min(last, 0.05 * std::pow(last / 0.05, k / 60.0)));
    return loop;
}

static DirectedGains gains(std::mt19937& engine, std::size_t m) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    DirectedGains found;
    for (std::size_t j = 0; j < m; j++) {
        found.kp.push_back(5 + 50 * uniform(engine));
        found.kd.push_back(1 + 5 * uniform(engine));
        found.ki.push_back(uniform(engine));
    }
    return found;
}

static bool looked(DirectedLoop& loop, const DirectedGains& own, double factor, double phase) {
    gainroom::LoopSamples samples(loop, own, factor, phase, 0.8);
    if (!samples.ok()) return false;
    gainroom::LoopCurves curves(samples);
    if (samples.unstable() == 0) curves.least();
    for (const bool locus : {true, false}) {
        for (const bool axis : {true, false})
            for (const gainroom::CurveStep& step : curves.meets(locus, axis)) curves.polished(step, axis, own, 1e-6, 8, true);
        curves.ends(locus, own, 2.0, true);
    }
    curves.crossings(own, true, true, 2.0);
    gainroom::SensitivityPeaks(samples).above(own, 1.1, -1.0, 1.0, true);
    gainroom::SensitivityPeaks(samples).highest_of_each(1.0, 0.0);
    curves.one_loop();
    curves.common_phase();
    curves.common_factors();
    curves.passing_factors();
    curves.lag_about(10.0);
    for (const gainroom::Gain gain : {gainroom::Gain::all, gainroom::Gain::kp, gainroom::Gain::kd})
        if (gain == gainroom::Gain::all || loop.joints()) {
            curves.growths(gain);
            for (const double change : {-0.999, 0.5, 999.0}) samples.one_loop_count(0, change, gain);
        }
    gainroom::LoopSamples other(loop, own, 1.05, phase, 0.5, true, false);
    if (other.ok()) other.crossed(std::polar(1.0, -phase));
    return true;
}

int main() {
    std::mt19937 engine(1);
    int ordinary = 0, hostile = 0;
    for (int k = 0; k < 24; k++) {
        const std::size_t n = 1 + static_cast<std::size_t>(k % 5), m = k % 3 == 2 ? 1 + n / 2 : n;
        DirectedLoop loop = draw(engine, n, m, k % 2 == 0, k % 4 == 1, k % 5 == 4);
        for (int again = 0; again < 3; again++) ordinary += looked(loop, gains(engine, m), again == 2 ? 100.0 : 3.0, again == 2 ? gainroom::kPi : 0.7);
    }
    const double nothing = std::numeric_limits<double>::quiet_NaN(), infinite = std::numeric_limits<double>::infinity();
    for (const double value : {nothing, infinite, -infinite, 0.0, 1e300, -1e300, 1e-300})
        for (int place = 0; place < 12; place++) {
            DirectedLoop loop = draw(engine, 3, 3, place % 2 == 0, place == 4, place > 8);
            DirectedGains own = gains(engine, 3);
            if (place == 0) own.kp[0] = value;
            if (place == 1) own.kd.assign(3, value);
            if (place == 2) loop.actuated.mobility[0] = value;
            if (place == 3) loop.actuated.motor_inertia[1] = value;
            if (place == 4) loop.actuated.contact_stiffness[0] = value;
            if (place == 5) loop.actuated.delay[0] = value;
            if (place == 6) loop.actuated.gravity[0] = value;
            if (place == 7) loop.shaping.gain = value;
            if (place == 8) loop.grid.back() = value;
            if (place == 9) loop.actuated.hessenberg.a[0] = value;
            if (place == 10) loop.actuated.whole.c[0] = value;
            if (place == 11) loop.grid.assign(2, value);
            hostile += looked(loop, own, 3.0, 0.7);
        }
    DirectedLoop wide = draw(engine, 20, 20, false, false, false);
    looked(wide, gains(engine, 20), 3.0, 0.7);
    std::printf("%d %d\n", ordinary, hostile);
}
