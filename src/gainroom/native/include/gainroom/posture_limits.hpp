// The gain limit of one control in one posture after another: CoupledLimit, with what does not depend on posture computed once, and each
// posture begun from the crossings of the one before.
//
// Where a search begins decides what it costs, not what is proved. With the first posture of a batch nothing is begun from, so that a
// batch gives the same numbers wherever it is computed.
#pragma once

#include <limits>
#include <vector>

#include "coupled_limit.hpp"

namespace gainroom {

// The lowest crossing; gain infinite: none below the factors that were searched.
struct PostureLimit {
    bool proved = false;
    double omega = 0.0, gain = 0.0;
    std::size_t joint = 0;  // that moves most
};

class PostureLimits {
   public:
    // `loop`: laws and what sampling needs, any modes. `slow`, `fast` [rad/s]: no corner frequency of the laws and no inverse of what leads and
    // lags together lies below, none above. `highest`: the factors that are searched, one after the other. `passive`: see CoupledLimit::search.
    PostureLimits(const ModalLoop& loop, double slow, double fast, std::vector<double> highest, bool passive)
        : loop_(loop), slow_(slow), fast_(fast), highest_(std::move(highest)) {
        last_ = loop.step > 0 ? kPi / loop.step : 0.0;
        if (!passive) return;
        const std::vector<Interval> left = Exclusion(loop_, 0.0, 1.0, 0.0).not_leading(kLow * slow, kHigh * fast);
        leading_ = left.empty() ? kHigh * fast : left.front().low;
    }

    std::size_t size() const { return loop_.size; }
    void forget() { near_.clear(); }

    // M₀ (n, n), φ (m, n), λ and μ (m) of Modes (system/modes.py), and how far their sum is off.
    PostureLimit at(const double* rigid, const double* shapes, const Complex* poles, const Complex* partners, std::size_t modes, double inexact) {
        const std::size_t n = loop_.size;
        loop_.modes = modes;
        loop_.rigid.assign(rigid, rigid + n * n);
        loop_.shapes.assign(shapes, shapes + modes * n);
        loop_.poles.assign(poles, poles + modes);
        loop_.partners.assign(partners, partners + modes);
        loop_.inexact = inexact;
        loop_.prepare();
        PostureLimit found;
        for (const double highest : highest_)
            if (!searched(highest, found) || found.gain < highest) break;
        return found;
    }

   private:
    static constexpr double kLow = 0.01, kHigh = 10.0, kSmall = 0.1;  // LOW, HIGH and SMALL of proved_limit.py
    static constexpr int kDoublings = 40;
    static constexpr double kNudge = 1e-6, kFloor = 1e-4, kFactor = 3.0;  // NUDGE, NARROWEST and FACTORS of modal_loop.py
    static constexpr std::size_t kNear = 2;

    ModalLoop loop_;
    double slow_, fast_, last_, leading_ = 0.0;
    std::vector<double> highest_, grid_;
    std::vector<Crossing> near_;

    // Factors up to `highest`; false where nothing is proved.
    bool searched(double highest, PostureLimit& found) {
        double low = slow_, high = fast_;
        for (const auto* part : {&loop_.poles, &loop_.partners})
            for (const Complex pole : *part) {
                low = std::min(low, size_of(pole));
                high = std::max(high, size_of(pole));
            }
        low = std::max(kLow * low, leading_);
        high = last_ > 0 ? last_ : kHigh * high;
        found.proved = false;
        if (!leads(low) || !(low > 0 && high > low)) return false;
        for (int k = 0; last_ == 0 && !small(high, highest); k++, high *= 2)
            if (k == kDoublings) return false;
        intervals(low, high);
        CoupledLimit limit(loop_);
        limit.begin(near_, low, high, highest);
        if (!limit.search(grid_.data(), grid_.size(), {0.0, highest}, kNudge, kFloor, false)) return false;
        near_ = limit.crossings;
        if (near_.size() > kNear) near_.resize(kNear);
        found.gain = std::numeric_limits<double>::infinity();
        if (!near_.empty()) {
            const Crossing& first = near_.front();
            if (!(first.growth > 0)) return false;
            found.omega = first.omega;
            found.gain = first.gain;
            double most = 0.0;
            for (std::size_t i = 0; i < loop_.size; i++) {
                const double moved = std::norm(times(first.vector[i], loop_.inverse_law(i, first.omega)));
                if (moved > most * (1 + kEqual)) {
                    most = moved;
                    found.joint = i;
                }
            }
        }
        return found.proved = true;
    }
    static constexpr double kEqual = 1e-6;  // of two joints that move alike the first counts

    // Every law leads there: Re d > 0.
    bool leads(double omega) const {
        for (std::size_t i = 0; i < loop_.size; i++)
            if (loop_.alike[i] == i && !(loop_.inverse_law(i, omega).real() > 0)) return false;
        return true;
    }

    // L times `highest` is small at ω: rows of |Q_ij|/√(|d_i||d_j|).
    bool small(double omega, double highest) const {
        const std::size_t n = loop_.size;
        std::vector<Complex> functions(loop_.modes), laws(n), row(n);
        Complex f0;
        loop_.functions(omega, f0, functions.data());
        loop_.inverse_laws(omega, laws.data());
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = 0; j < n; j++) row[j] = f0 * loop_.rigid[i * n + j];
            for (std::size_t k = 0; k < loop_.modes; k++) {
                const Complex f = times(functions[k], loop_.shapes[k * n + i]);
                for (std::size_t j = 0; j < n; j++) row[j] += times(f, loop_.shapes[k * n + j]);
            }
            double sum = 0.0;
            for (std::size_t j = 0; j < n; j++) sum += size_of(row[j]) / std::sqrt(size_of(laws[i]) * size_of(laws[j]));
            if (!(highest * sum < kSmall)) return false;
        }
        return true;
    }

    // From `low` to `high` in steps no longer than kFactor, with every resonance; sampled, half of the way to half the sample rate.
    void intervals(double low, double high) {
        const int count = 1 + int(std::log(high / low) / std::log(kFactor));
        grid_.clear();
        for (int k = 1; k <= count; k++) grid_.push_back(low * std::pow(high / low, double(k) / count));
        grid_.back() = high;
        for (const Complex pole : loop_.poles) grid_.push_back(std::fabs(pole.imag()));
        if (last_ > 0) grid_.push_back(0.5 * last_);
        std::sort(grid_.begin(), grid_.end());
        std::size_t kept = 1;
        grid_.insert(grid_.begin(), low);
        for (std::size_t k = 1; k < grid_.size(); k++)
            if (grid_[k] <= high && grid_[k] - grid_[kept - 1] > kFloor * grid_[k]) grid_[kept++] = grid_[k];
        grid_.resize(kept);
        if (grid_.back() < high) grid_.back() = high;
    }
};

}  // namespace gainroom
