// Random and hostile coupled loops through coupled_limit.hpp: it ends, and stays inside its memory. Prints how many limits were proved.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/coupled_limit.hpp"

using gainroom::Complex;

static gainroom::ModalLoop draw(std::mt19937& engine, std::size_t size, std::size_t modes, bool pairs, double step) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    gainroom::ModalLoop loop;
    loop.size = size;
    loop.modes = modes;
    loop.rigid.assign(size * size, 0.0);
    for (std::size_t i = 0; i < size; i++) loop.rigid[i * size + i] = 0.3 + uniform(engine);
    for (std::size_t k = 0; k < modes * size; k++) loop.shapes.push_back({uniform(engine) - 0.5, pairs ? 0.0 : 0.1 * uniform(engine)});
    for (std::size_t k = 0; k < modes; k++) {
        loop.poles.push_back({-1 - 5 * uniform(engine), 50 + 400 * uniform(engine)});
        if (pairs) loop.partners.push_back(std::conj(loop.poles.back()));
    }
    loop.bandwidth = 3000.0;
    loop.damping_ratio = 0.8;
    loop.fraction = uniform(engine);
    loop.step = step;
    loop.inexact = 1e-12;
    for (std::size_t i = 0; i < size; i++) {
        const double kp = 20 + 100 * uniform(engine), kd = 1 + 5 * uniform(engine);
        if (step > 0)
            loop.laws.push_back({{Complex(-kp / (kd + kp * step))}, {Complex(-1 / step)}, kd / step + kp});
        else
            loop.laws.push_back({{Complex(-kp / kd)}, {Complex(-3000.0), Complex(-4000.0)}, kd * 1.2e7});
        loop.delays.push_back(step > 0 ? 4 * step : 2e-3);
    }
    loop.prepare();
    return loop;
}

static int proved(const gainroom::ModalLoop& loop) {
    std::vector<double> grid;
    const double last = loop.step > 0 ? gainroom::kPi / loop.step : 3e4;
    for (int k = 0; k <= 20; k++) grid.push_back(0.05 * std::pow(last / 0.05, k / 20.0));
    gainroom::CoupledLimit limit(loop);
    const bool found = limit.search(grid.data(), grid.size(), {0.0, 100.0}, 1e-6, 1e-4, loop.step == 0);
    for (const double stop : {100.0, 1e-3}) {  // on from the gains themselves, with the turns of det F
        gainroom::CoupledLimit on(loop);
        on.search(grid.data(), grid.size(), {1.0, stop}, 1e-6, 1e-4, loop.step == 0, true);
    }
    return found ? 1 : 0;
}

// Pairs of channels that are taken for a loop that is not symmetric, in coordinates that are anything.
static void twofold(gainroom::ModalLoop loop, std::mt19937& engine) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    loop.twofold = true;
    loop.skew.assign(loop.size * loop.size, 0.0);
    loop.prepare();
    const std::vector<double> grid = {0.1, 1.0, 30.0, 500.0, 3000.0};
    std::vector<Complex> bases;
    for (std::size_t k = 0; k < (grid.size() - 1) * loop.size * loop.size; k++) bases.push_back({uniform(engine) - 0.5, uniform(engine)});
    gainroom::CoupledLimit(loop).search(grid.data(), grid.size(), {1.0, 10.0}, 1e-6, 1e-4, false, true, bases.data());
}

int main() {
    std::mt19937 engine(1);
    int ordinary = 0;
    for (int k = 0; k < 40; k++)
        ordinary += proved(draw(engine, 1 + static_cast<std::size_t>(k % 6), static_cast<std::size_t>(k % 4), k % 2 == 0, k % 3 == 0 ? 1e-3 : 0.0));
    const double nothing = std::numeric_limits<double>::quiet_NaN(), infinite = std::numeric_limits<double>::infinity();
    int hostile = 0;
    for (const double value : {nothing, infinite, -infinite, 0.0, 1e300, -1e300, 1e-300}) {
        for (int place = 0; place < 6; place++) {
            gainroom::ModalLoop loop = draw(engine, 3, 2, place % 2 == 0, place < 3 ? 0.0 : 1e-3);
            if (place == 0) loop.rigid[0] = value;
            if (place == 1) loop.shapes[1] = value;
            if (place == 2) loop.poles[0] = value;
            if (place == 3) loop.laws[0].gain = value;
            if (place == 4) loop.delays[1] = value;
            if (place == 5) loop.laws[2].zeros[0] = value;
            loop.prepare();
            hostile += proved(loop);
            gainroom::ModalLoop even = draw(engine, 4, 2, place % 2 == 0, place < 3 ? 0.0 : 1e-3);
            if (place == 3) even.laws[0].gain = value;
            if (place == 1) even.shapes[1] = value;
            twofold(even, engine);
        }
    }
    hostile += proved(draw(engine, 0, 0, true, 0.0));
    gainroom::ModalLoop wide = draw(engine, 60, 60, true, 0.0);
    hostile += proved(wide);
    std::printf("%d %d\n", ordinary, hostile);
    return 0;
}
