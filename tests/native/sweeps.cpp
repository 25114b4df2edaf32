// Four frequencies of a count at once beside one at a time: random joints and W, rigid or elastic, sampled or not; among them NaN, infinite,
// zero and huge numbers. Prints how many were compared, the largest difference of phases and, relative, of slopes. Then counts of single roots much
// nearer to the axis than steps are long: how many come to an end, and how many of these are wrong.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/joint_loop.hpp"
#include "gainroom/phase_sweep.hpp"

using namespace gainroom;

static std::mt19937 generator(11);

static double drawn(double low, double high) { return low * std::pow(high / low, std::uniform_real_distribution<double>()(generator)); }

static std::vector<double> symmetric(std::size_t n) {
    std::vector<double> root(n * n), found(n * n, 0.0);
    for (double& x : root) x = std::normal_distribution<double>()(generator);
    for (std::size_t i = 0; i < n; i++)
        for (std::size_t j = 0; j < n; j++)
            for (std::size_t k = 0; k < n; k++) found[i * n + j] += root[i * n + k] * root[j * n + k] / double(n);
    return found;
}

// F(jω) = jω − p: a root of damping σ at ω₀ that the factor takes past the axis, at 1.
struct OneRoot final : TrackedLoop {
    double damping = 0.0, place = 0.0, last_omega = 0.0, last_gain = 0.0;

    std::size_t posture_size() const override { return 0; }
    std::size_t mode_size() const override { return 1; }
    std::size_t channels() const override { return 1; }
    double sample_time() const override { return 0.0; }
    double lowest() const override { return 1.0; }
    double usual_slices() const override { return 1.0; }
    double urgent_slices() const override { return 1.0; }
    double distance(const double*, const double*) override { return 0.0; }
    bool follow(const double*, TrackedCrossing&, int, double&, bool) override { return false; }
    double phase(const double*, double omega, double gain, Complex* slope) override {
        last_omega = omega;
        last_gain = gain;
        if (slope) *slope = Complex(0.0, 1.0) / Complex(damping * (1.0 - gain), omega - place);
        return whole_phase();
    }
    double whole_phase() override { return std::atan2(last_omega - place, damping * (1.0 - last_gain)); }
    double resonance(const double*) const override { return 1.0; }
    double top(const double*, double, double) override { return 1000.0; }
    double resolution(double) const override { return kWidest; }
};

static void count_roots(int draws, int& ended, int& wrong) {
    OneRoot loop;
    PhaseSweep sweep;
    for (int number = 0; number < draws; number++) {
        loop.place = drawn(10.0, 100.0);
        loop.damping = loop.place * drawn(1e-5, 1e-1);
        const double gain = number % 2 ? 0.5 : 1.5;
        PhaseSweep::State state = sweep.begin(loop, nullptr, gain);
        while (state == PhaseSweep::State::running) state = sweep.advance(loop, nullptr);
        if (state != PhaseSweep::State::done) continue;
        ended++;
        wrong += sweep.pairs() != (gain > 1.0);
    }
}

int main() {
    using Limits = std::numeric_limits<double>;
    const double odd[] = {0.0, 1e300, 1e-300, Limits::infinity(), Limits::quiet_NaN()};
    long compared = 0;
    double phases = 0.0, slopes = 0.0;
    for (int number = 0; number < 120; number++) {
        const bool hostile = number % 3 == 2;
        const std::size_t n = 1 + generator() % (number % 10 ? 13 : 40);
        std::vector<JointData> joints;
        const bool rigid = generator() % 4 == 0;
        for (std::size_t i = 0; i < n; i++) {
            if (i > 0 && generator() % 3 == 0) {
                joints.push_back(joints.back());
                continue;
            }
            joints.push_back({drawn(1e-2, 1.0), drawn(1e-3, 1.0), drawn(1e-3, 1.0), rigid ? Limits::infinity() : drawn(1e2, 1e5), rigid ? 0.0 : drawn(1e-2, 10.0),
                              drawn(300.0, 5000.0), 0.9, drawn(5e-4, 5e-3), drawn(10.0, 2000.0), drawn(1.0, 50.0)});
        }
        std::vector<double> w = symmetric(n);
        if (hostile) w[generator() % w.size()] = odd[generator() % 5];
        JointLoop loop(joints.data(), n, generator() % 2 ? 5e-4 : 0.0);
        for (int look = 0; look < 20; look++) {
            Slice slices[4];
            const std::size_t count = 1 + generator() % 4;
            const double gain = hostile && look % 5 == 0 ? odd[generator() % 5] : drawn(0.01, 10.0);
            for (std::size_t k = 0; k < count; k++) slices[k].omega = drawn(5.0, 3000.0);
            loop.phases(w.data(), gain, slices, count);
            for (std::size_t k = 0; k < count; k++) {
                Complex slope;
                const double phase = loop.phase(w.data(), slices[k].omega, gain, &slope);
                if (hostile) continue;
                compared++;
                phases = std::fmax(phases, std::fabs(wrapped(phase - slices[k].phase)));
                slopes = std::fmax(slopes, std::abs(slope - slices[k].slope) / (std::abs(slope) + double(n) / slices[k].omega));
                if (!std::isfinite(phases + slopes + slices[k].phase)) return 1;
            }
        }
    }
    int ended = 0, wrong = 0;
    count_roots(20000, ended, wrong);
    std::printf("%ld %a %a %d %d\n", compared, phases, slopes, ended, wrong);
}
