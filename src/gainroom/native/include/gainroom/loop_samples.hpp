// Coupled loops along the stability boundary: S_ii, ln det(I + L), the eigenvalues of L, and where some may come near −1 these loci, from
// sample to sample as finely as they need; and the number of unstable roots.
//
// With M = (I + L)⁻¹ − I/2 the eigenvalues λ of L and μ of M belong together by 2μ = (1 − λ)/(1 + λ). A λ in [−g, −1/g], or on the unit
// circle within φ of −1, has |μ| ≥ `wanted`.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "complex.hpp"
#include "directed_loop.hpp"
#include "locus_step.hpp"
#include "loop_sample.hpp"
#include "passed_unseen.hpp"
#include "sample_solver.hpp"

namespace gainroom {

enum class LookState { followed, lost, singular };

constexpr int kUncounted = -1000000;

class LoopSamples {
public:
    // No samples.
    LoopSamples(DirectedLoop& loop, const DirectedGains& gains) : loop_(loop), gains_(gains), m_(loop.directions), solver_(loop) {
        for (std::size_t j = 0; j < m_; j++) idle_ |= gains.kp[j] == 0 && gains.kd[j] == 0 && gains.ki[j] == 0;
    }

    // `between`: the first samples lie halfway between those of the loop, so that all others are apart from those of another look. `smooth`: of a
    // stable loop S_ii are followed, too.
    LoopSamples(DirectedLoop& loop, const DirectedGains& gains, double factor, double phase, double peak, bool between = false,
                bool smooth = true)
        : LoopSamples(loop, gains) {
        wanted_ = 0.9 * std::min(0.5 * (factor + 1) / (factor - 1), phase < kPi ? 0.5 / std::tan(0.5 * phase) : 0.0);
        near_ = std::min(kNear * wanted_, std::max(kFar, 0.5 * kNear * wanted_));
        highest_ = std::max(3.0, factor);
        for (const double delay : loop.actuated.delay) longest_ = std::max(longest_, delay);
        reach_factor_ = std::log(factor);
        reach_phase_ = phase;
        peak_ = std::min({kPeak, wanted_, peak});
        loop_.forget();
        state_ = LookState::followed;
        const std::vector<double>& grid = loop_.grid;
        for (std::size_t k = 0; k < grid.size(); k++) {
            const bool inside = k > 0 && k + 1 < grid.size();  // the boundary ends at the last sample
            add(between && inside ? std::sqrt(grid[k - 1] * grid[k]) : grid[k]);
        }
        if (between && grid.size() > 2) add(std::sqrt(grid[grid.size() - 2] * grid.back()));
        if (!grid.empty()) add(kBeside * grid.front());
        sort();
        if (samples_.size() < 2) state_ = LookState::lost;
        if (ok()) {
            begin_at_integrators();
            reach_down();
            reach_up();
            refine(nothing);
        }
        if (ok()) count_ = counted();
        if (ok() && count_ == 0 && smooth) {  // what is unstable has no margins
            smooth_ = true;
            for (auto& one : samples_) one->next = nullptr;
            refine(nothing);
        }
    }

    bool ok() const { return state_ == LookState::followed; }
    LookState state() const { return state_; }
    int unstable() const { return count_; }
    const std::vector<std::unique_ptr<LoopSample>>& samples() const { return samples_; }
    DirectedLoop& loop() { return loop_; }
    const DirectedGains& gains() const { return gains_; }

    // Roots that cross the boundary on the way from this loop to one with L times `factor` (a gain, or e^{−jφ}), as far as loci are known.
    int crossed(Complex factor) {
        refine([&](const LoopSample& low, const LoopSample& high) {
            for (std::size_t i = 0; i < m_; i++) {
                const Complex before = low.loci.values[i], after = high.loci.values[low.pairs[i]];
                if (!(stays_small(factor, before) && stays_small(factor, after)) && passes(times(factor, before), times(factor, after))) return true;
            }
            return false;
        });
        if (!ok()) return 0;
        double turned = 0.0;
        for (std::size_t k = 0; k + 1 < samples_.size(); k++) {
            const LoopSample &low = *samples_[k], &high = *samples_[k + 1];
            if (!near(low, high)) continue;
            for (std::size_t i = 0; i < m_; i++) {
                const Complex before = low.loci.values[i], after = high.loci.values[low.pairs[i]];
                if (stays_small(factor, before) && stays_small(factor, after) && stays_small(1.0, before) && stays_small(1.0, after)) continue;
                turned += 2 * kPi * (wraps(1.0 + times(factor, before), 1.0 + times(factor, after)) - wraps(1.0 + before, 1.0 + after));
            }
            const bool first = k == 0 || !near(*samples_[k - 1], low), end = k + 2 == samples_.size() || !near(high, *samples_[k + 2]);
            if (first) turned -= begun(low, factor);
            if (end) turned += begun(high, factor);
        }
        return -static_cast<int>(std::lround(turned / kPi));
    }

    // LoopSample::closed of a joint, with more places where it may pass the negative real axis unseen, left of where it surely does or of what a
    // thousandfold gain brings to −1; empty where one is lost. Known until there are more samples.
    const std::vector<CurvePlace>& closed_curve(std::size_t joint, Gain gain) {
        auto& [samples, places] = curves_[{joint, gain}];
        if (samples == samples_.size() && ok()) return places;
        samples = samples_.size();
        places.clear();
        if (!ok()) return places;
        for (const auto& one : samples_) places.push_back({one->omega(), one->closed(joint, gain)});
        const double own = gain == Gain::kp ? gains_.kp[joint] : gain == Gain::kd ? gains_.kd[joint] : 1.0;
        for (int round = 0; round < kCurveRounds && places.size() < kMost; round++) {
            const std::vector<std::size_t> found = passed_unseen(places, own > 0 ? 1e-3 / own : 0.0);
            if (found.empty()) break;
            for (const std::size_t k : found) {
                const double low = places[k].omega, high = places[k + 1].omega;
                const auto middle = inverted(high > 4 * low ? std::sqrt(low * high) : 0.5 * (low + high));
                if (middle == nullptr) {
                    places.clear();
                    return places;
                }
                places.push_back({middle->omega(), middle->closed(joint, gain)});
            }
            std::sort(places.begin(), places.end(), [](const CurvePlace& a, const CurvePlace& b) { return a.omega < b.omega; });
        }
        return places;
    }

    // Roots that a `change` of the gains that act on what joint i measures, all as a part of themselves or one of them, makes unstable: by the turns
    // of 1 + change T_ii u about 0, which is det(I + L) with it over det(I + L); T = I − S, and u is what the gain multiplies over the joint's law.
    // kUncounted where that settles nowhere, or does not fall.
    int one_loop_count(std::size_t joint, double change, Gain gain) {
        const auto at = [&](const LoopSample& sample) { return CurvePlace{sample.omega(), 1.0 + change * sample.closed(joint, gain)}; };
        std::vector<CurvePlace> places;
        for (const CurvePlace& one : closed_curve(joint, gain)) places.push_back({one.omega, 1.0 + change * one.value});
        if (places.size() < 2) return kUncounted;
        int order = 0;
        const auto begins = [&] {  // as the real value at rest: over a doubling of ω it moves little; or as r/(jω)ᵏ of what drifts, r real
            const Complex lowest = places[0].value, drift = lowest - 1.0;
            std::size_t next = 1;
            while (next + 1 < places.size() && places[next].omega < 2 * places[0].omega) next++;
            order = 0;
            const bool level = std::fabs(lowest.imag()) < kReal * std::fabs(lowest.real()) && size_of_any(places[next].value - lowest) < kReal * size_of_any(lowest);
            if (level && size_of_any(drift) < kRising * size_of_any(places[next].value - 1.0)) return true;
            const double fall = std::log(size_of_any(drift) / size_of_any(places[next].value - 1.0)) / std::log(places[next].omega / places[0].omega);
            order = static_cast<int>(std::lround(fall));
            const Complex own = times(drift, std::polar(1.0, 0.5 * kPi * order));
            return order > 0 && std::fabs(fall - order) < kWhole && size_of_any(drift) > kOutside && std::fabs(own.imag()) < kReal * std::fabs(own.real());
        };
        for (int round = 0; round < kDeeper && !begins(); round++) {
            const auto lower = inverted(0.25 * places.front().omega);
            if (lower == nullptr) return kUncounted;
            places.insert(places.begin(), at(*lower));
        }
        const auto falls = [&] {
            const Complex last = places.back().value;
            return std::isinf(loop_.last) ? size_of_any(last - 1.0) < 0.5 : std::fabs(last.imag()) < kReal * std::fabs(last.real());
        };
        for (int round = 0; round < kDeeper && std::isinf(loop_.last) && !falls(); round++) {
            const auto higher = inverted(2 * places.back().omega);
            if (higher == nullptr) return kUncounted;
            places.push_back(at(*higher));
        }
        if (!begins() || !falls()) return kUncounted;
        // From the real value just right of ω = 0, about which r/sᵏ turns back by a quarter k times.
        const Complex turned_back = times(places.front().value, std::polar(1.0, 0.5 * kPi * order));
        double turned = std::arg(turned_back.real() < 0 ? -turned_back : turned_back) - 0.5 * kPi * order;
        std::vector<CurvePlace> ahead;  // the nearest last
        std::size_t halved = 0;
        for (std::size_t k = 0; k + 1 < places.size(); k++) {
            CurvePlace here = places[k];
            ahead.assign(1, places[k + 1]);
            while (!ahead.empty()) {
                const CurvePlace next = ahead.back();
                const Complex move = next.value - here.value;
                const double along = std::clamp(times(-here.value, std::conj(move)).real() / std::max(std::norm(move), 1e-300), 0.0, 1.0);
                if (std::norm(here.value + along * move) > std::norm(move)) {
                    turned += std::arg(times(next.value, std::conj(here.value)));
                    here = next;
                    ahead.pop_back();
                    continue;
                }
                if (next.omega - here.omega <= 1e-3 * kClosest * next.omega || ++halved > kMost) return kUncounted;
                const auto middle = inverted(0.5 * (here.omega + next.omega));
                if (middle == nullptr) return kUncounted;
                ahead.push_back(at(*middle));
            }
        }
        if (std::isinf(loop_.last)) turned -= std::arg(places.back().value);
        return -static_cast<int>(std::lround(turned / kPi));
    }

    // More samples where loci that nearly meet, or curves that nearly turn, may cross with less than these, or as far as they are followed.
    void tell_apart(double factor, double phase) {
        if (!ok() || count_ != 0) return;
        factor = std::min(factor, reach_factor_);
        phase = std::min(phase, reach_phase_);
        refine([&](const LoopSample& low, const LoopSample& high) {
            return high.omega() - low.omega() > kApart * high.omega() && may_exchange(low.loci, high.loci, low.pairs, factor, phase);
        });
        show_crossings(factor, phase);
    }

    // Whether loci are followed between two samples that are neighbours.
    bool near(const LoopSample& low, const LoopSample& high) const { return low.near || high.near; }

    // A sample that does not belong to the others, perhaps without its inverse; `near`: it counts as one whose loci come near −1.
    std::unique_ptr<LoopSample> sample(double omega, bool near = false) {
        auto found = begun(omega);
        if (found == nullptr) return nullptr;
        const auto describe = [&] {
            const std::vector<Complex>& values = found->loci.values;
            found->loci.describe();
            found->near = near || std::any_of(values.begin(), values.end(), [&](Complex one) { return nearer(one, near_); });
        };
        const bool symmetric = solver_.find_symmetric(*found);
        if (symmetric) describe();
        if (symmetric && found->near && loop_.own() && !idle_ && solver_.close_symmetric(*found)) return found;
        if (!close(*found)) return nullptr;
        if (symmetric) return found;
        if (!solver_.find_other(*found)) {
            state_ = LookState::lost;
            return nullptr;
        }
        describe();
        return found;
    }

    // The same with its inverse, and without loci.
    std::unique_ptr<LoopSample> inverted(double omega) {
        auto found = begun(omega);
        return found != nullptr && close(*found) ? std::move(found) : nullptr;
    }

    // S_ii (n) of other gains, where this loop was sampled; empty where I + L is singular.
    std::vector<Complex> sensitivity(const LoopSample& there, const DirectedGains& gains) {
        LoopSample other = solver_.begun(there.point, gains);
        return solver_.close(other) ? other.sensitivity : std::vector<Complex>();
    }

    SampleSolver& solver() { return solver_; }

    // The loci that settle as ω → 0, which are real there.
    std::vector<Complex> at_rest() {
        std::vector<Complex> found;
        auto rest = sample(1e-6 * samples_.front()->omega());
        if (rest == nullptr) return found;
        const std::vector<double> falling = falls();
        for (const Complex& value : rest->loci.values)
            for (std::size_t i = 0; i < m_; i++) {
                const double settled = size_of_any(samples_.front()->loci.values[i]);
                if (std::fabs(falling[i]) < 0.5 && std::fabs(size_of_any(value) - settled) < 0.1 * settled) {
                    found.push_back(value);
                    break;
                }
            }
        return found;
    }

private:
    // As in analysis/stability_boundary.py.
    static constexpr double kSmooth = 0.12, kDetour = 0.5, kGrowth = 0.7, kLarge = 1e3, kHuge = 1e9, kNoise = 1e-10, kSteepest = 2.5;
    static constexpr double kAstray = 0.02, kReal = 0.3, kOutside = 10.0, kBeside = 1.02, kLowest = 1e-12, kClosest = 1e-10;
    // Of what is wanted: between two samples that are further from −1 by half no locus comes as near as that. Where L is small |μ| is 0.5.
    static constexpr double kNear = 0.9, kFar = 0.55;
    static constexpr double kPeak = 0.8, kJump = 0.4;  // |S_ii − 1/2| from which on S_ii is followed closely; a move that is halved anyway
    static constexpr double kApart = 1e-6;  // of ω: what is not halved to tell loci apart
    static constexpr double kTurn = 1.5;  // rad, of a delay between two samples: more may hide a whole turn of loci that matter
    static constexpr std::size_t kMost = 12000;
    static constexpr int kCurveRounds = 40;
    // How near to a whole number the order of a fall has to be; by how much over a doubling of ω what drifts rises towards rest.
    static constexpr double kWhole = 0.1, kRising = 1.5;
    static constexpr int kDeeper = 30;  // times that a lower frequency is tried, for T_ii to settle

    // Null where the loop has no finite value.
    std::unique_ptr<LoopSample> begun(double omega) {
        auto point = loop_.known(omega);
        if (point == nullptr) state_ = LookState::lost;
        return point == nullptr ? nullptr : std::make_unique<LoopSample>(solver_.begun(std::move(point), gains_));
    }

    bool close(LoopSample& sample) {
        const bool regular = solver_.close(sample);
        if (!regular) state_ = LookState::singular;
        return regular;
    }

    void add(double omega, bool near = false) {
        if (!ok() || !(omega > 0) || omega > loop_.last) return;
        auto found = sample(omega, near);
        if (found == nullptr) return;
        if (found->near) std::vector<Complex>().swap(found->inverse);  // loci are followed there
        samples_.push_back(std::move(found));
    }

    // The first `sorted` are so already.
    void sort(std::size_t sorted = 0) {
        const auto lower = [](const auto& a, const auto& b) { return a->omega() < b->omega(); };
        const auto fresh = samples_.begin() + static_cast<std::ptrdiff_t>(sorted);
        std::sort(fresh, samples_.end(), lower);
        std::inplace_merge(samples_.begin(), fresh, samples_.end(), lower);
        const auto same = [](const auto& a, const auto& b) { return a->omega() == b->omega(); };
        samples_.erase(std::unique(samples_.begin(), samples_.end(), same), samples_.end());
    }

    // (m) how each locus falls at the lowest sample, or another, as 1/ωᵏ: k; 0 where it is lost in round-off.
    std::vector<double> falls(std::size_t from = 0) {
        std::vector<double> found(m_, 0.0);
        const LoopSample &low = *samples_[from], &high = *samples_[from + 1];
        const std::vector<std::size_t> pairs = paired(low.loci, high.loci);
        const double most = low.loci.largest();
        for (std::size_t i = 0; i < m_; i++) {
            const double size = size_of_any(low.loci.values[i]), after = size_of_any(high.loci.values[pairs[i]]);
            if (size > std::max(1e-9, kNoise * most) && after > 0) found[i] = std::log(size / after) / std::log(high.omega() / low.omega());
        }
        return found;
    }

    static bool nothing(const LoopSample&, const LoopSample&) { return false; }

    template <typename Lost>
    void further_down(Lost lost) {
        std::vector<double> omegas = {samples_[0]->omega() / 16, samples_[0]->omega() / 4, kBeside * samples_[0]->omega() / 16};
        const std::size_t before = samples_.size();
        for (double omega : omegas) add(omega);
        sort();
        if (!ok()) return;
        for (double fall : falls())
            if (lost(fall)) {
                samples_.erase(samples_.begin(), samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() - before));
                bottom_ = true;
                return;
            }
    }

    // Of a loop that nothing topples, from where all loci are beyond kHuge and fall as whole powers of ω: further down a trace of friction, which
    // stands beside the integrators, loses its digits, and nothing comes near −1.
    void begin_at_integrators() {
        if (loop_.unstable_poles > 0 || loop_.settles > 0) return;
        const auto huge = [](const auto& one) {
            const std::vector<Complex>& values = one->loci.values;
            return std::all_of(values.begin(), values.end(), [](Complex value) { return size_of_any(value) > kHuge; });
        };
        std::size_t from = 0;
        while (from + 2 < samples_.size() && huge(samples_[from + 1])) from++;
        for (; from > 0; from--) {
            const std::vector<double> falling = falls(from);
            if (std::all_of(falling.begin(), falling.end(), [](double fall) { return std::fabs(fall - std::round(fall)) < kAstray; })) break;
        }
        if (from == 0) return;
        samples_.erase(samples_.begin(), samples_.begin() + static_cast<std::ptrdiff_t>(from));
        add(kBeside * samples_.front()->omega());
        sort();
    }

    // Down to where integrators rule, and settled loci are clearly on one side of −1.
    void reach_down() {
        const double slowest = loop_.slowest(gains_);
        for (int round = 0; round < 40 && ok() && !bottom_; round++) {
            const std::vector<double> falling = falls();
            if (!ok()) return;
            bool settled = samples_[0]->omega() < slowest;
            double most = 0.0;
            for (std::size_t i = 0; i < m_; i++) {
                const double size = size_of_any(samples_[0]->loci.values[i]);
                most = std::max(most, size);
                settled &= std::fabs(falling[i] - std::round(falling[i])) < 0.05 && !(falling[i] > 0.5 && size < kOutside);
            }
            if (settled || most > kHuge || samples_[0]->omega() < 1e3 * kLowest * samples_.back()->omega()) break;
            // Where gains take over from each other, zeros without much damping bend loci as steeply as round-off does.
            further_down([&](double fall) { return std::fabs(fall - 1) > kSteepest && samples_[0]->omega() < slowest; });
        }
        for (int round = 0; round < 20 && ok() && !bottom_; round++) {
            const std::vector<double> falling = falls();
            if (!ok()) return;
            bool unsettled = false;
            for (std::size_t i = 0; i < m_; i++) {
                const Complex one = 1.0 + samples_[0]->loci.values[i];
                const double order = std::round(falling[i]);
                unsettled |= order > 1 && size_of_any(samples_[0]->loci.values[i]) < 100;
                unsettled |= falling[i] != 0 && order == 0 && std::fabs(one.imag()) > 0.1 * std::fabs(one.real());
            }
            if (!unsettled || samples_[0]->omega() < kLowest * samples_.back()->omega()) break;
            further_down([](double fall) { return std::round(fall) > 0 && std::fabs(fall - std::round(fall)) > kAstray; });
        }
    }

    // Up to where the loci have become small.
    void reach_up() {
        for (int round = 0; round < 60 && ok() && std::isinf(loop_.last); round++) {
            if (samples_.back()->loci.largest() * highest_ <= 1 || samples_.back()->omega() > 1e12 * samples_.front()->omega()) return;
            const double top = samples_.back()->omega();
            add(1.5 * top);
            add(2 * top);
            sort();
        }
    }

    // Halve intervals until none is too rough; `doubtful` of those with loci, once they are paired.
    template <typename Doubtful>
    void refine(Doubtful doubtful) {
        for (int round = 0; round < 60 && ok(); round++) {
            std::vector<std::size_t> found;
            for (std::size_t k = 0; ok() && k + 1 < samples_.size(); k++) {
                LoopSample &low = *samples_[k], &high = *samples_[k + 1];
                const double width = high.omega() - low.omega();
                const bool narrow = width <= kClosest * high.omega();
                bool rough = false;
                if (low.next != &high) {
                    rough = !fine(low, high, width) && !narrow;
                    if (!rough) low.next = &high;
                }
                if (!rough && !narrow && near(low, high) && doubtful(low, high)) rough = true;
                if (rough) found.push_back(k);
            }
            if (found.empty() || !ok()) return;
            halve(found);
        }
    }

    // The same until nothing may pass the unit circle or the negative real axis unseen on any of them.
    void show_crossings(double factor, double phase) {
        const auto followed = [this](std::size_t k) { return near(*samples_[k], *samples_[k + 1]); };
        for (int round = 0; round < 60 && ok(); round++) {
            std::vector<std::size_t> found = passed_unseen(samples_, factor, phase, followed);
            const auto narrow = [this](std::size_t k) { return samples_[k + 1]->omega() - samples_[k]->omega() <= kApart * samples_[k + 1]->omega(); };
            found.erase(std::remove_if(found.begin(), found.end(), narrow), found.end());
            if (found.empty()) return;
            halve(found);
            refine(nothing);
        }
    }

    // Intervals from the k-th sample to the next.
    void halve(const std::vector<std::size_t>& intervals) {
        const std::size_t sorted = samples_.size();
        for (const std::size_t k : intervals) {
            const LoopSample &low = *samples_[k], &high = *samples_[k + 1];
            const bool wide = high.omega() > 4 * low.omega();
            add(wide ? std::sqrt(low.omega() * high.omega()) : 0.5 * (low.omega() + high.omega()), low.near && high.near);
        }
        sort(sorted);
        if (samples_.size() > std::max(kMost, 30 * kMost / (m_ * m_))) state_ = LookState::lost;
    }

    // Whether an interval is fine enough; its loci are paired, and how far arg det(I + L) turns over it is kept.
    bool fine(LoopSample& low, LoopSample& high, double width) {
        bool found = true;
        for (std::size_t i = 0; smooth_ && found && i < low.sensitivity.size(); i++) {
            const double most = std::max(std::norm(low.sensitivity[i] - 0.5), std::norm(high.sensitivity[i] - 0.5));
            const double move = std::norm(high.sensitivity[i] - low.sensitivity[i]);
            found = !(move > (most > peak_ * peak_ ? 0.04 * std::max(1.0, most) : kJump * kJump) && width > 1e-7 * high.omega());
        }
        const double most = std::max(low.loci.largest(), high.loci.largest());
        found = found && !(width * longest_ > kTurn && 2 * highest_ * most > 1);
        if (!near(low, high)) {
            const Complex ahead = expected(low, high), behind = -expected(high, low), mean = 0.5 * (ahead + behind);
            const Complex off = high.log_determinant - low.log_determinant - mean;
            const double turned = wrapped(off.imag());
            low.turned = mean.imag() + turned;
            const bool alike = size_of_any(ahead - behind) < 1.5 && size_of_any(Complex(off.real(), turned)) < 1.0;
            return found && alike && std::fabs(mean.imag()) < 0.8 * static_cast<double>(m_);
        }
        low.pairs = paired(low.loci, high.loci);
        low.turned = 0.0;
        for (std::size_t i = 0; i < m_; i++) {
            const std::size_t j = low.pairs[i];
            const Complex before = low.loci.values[i], after = high.loci.values[j];
            low.turned += high.loci.returned[j] - low.loci.returned[i] + 2 * kPi * wraps(1.0 + before, 1.0 + after);
            if (!found) continue;
            const double read = 0.8 * wanted_;  // what stays further from −1 has no margins that are asked for
            const bool close = nearer(before, read) || nearer(after, read) || nearer(nearest_to_minus_one(before, after), read);
            found = !(close && rough(low, i, high, j, most)) && !passes(before, after);
        }
        return found;
    }

    // How ln det(I + L) changes on the way from one sample to another, if all of I + L turned and grew alike: m ln(tr(A⁻¹ B)/m). Where 1 + ε_i are
    // the eigenvalues of A⁻¹ B over their mean it is off by Σ ε_i²/2, and the way back by as much to the other side: both show if one grows alone.
    Complex expected(const LoopSample& from, const LoopSample& to) const {
        Complex trace = 0.0;
        for (std::size_t i = 0; i < m_; i++)
            for (std::size_t j = 0; j < m_; j++) {
                const Complex entry = times(to.point->seen[j * m_ + i], to.law[i]) + (i == j ? 1.0 : 0.0);
                trace += times(from.inverse[i * m_ + j], entry);
            }
        return static_cast<double>(m_) * std::log(trace / static_cast<double>(m_));
    }

    bool rough(const LoopSample& low, std::size_t i, const LoopSample& high, std::size_t j, double most) const {
        const double size = std::exp(std::max(low.loci.sizes[i], high.loci.sizes[j]));
        if (!(size > std::max(1 / highest_, kNoise * most))) return false;
        const double away = kPi - std::max(std::fabs(low.loci.angles[i]), std::fabs(high.loci.angles[j]));
        const double turned = kPi - std::fabs(std::fabs(high.loci.angles[j] - low.loci.angles[i]) - kPi), grown = std::fabs(high.loci.sizes[j] - low.loci.sizes[i]);
        const double far = size > kLarge ? turned * size : std::sqrt(std::norm(high.loci.values[j] - low.loci.values[i]));
        return (turned > kDetour * away || grown > kGrowth) && far > kSmooth * size;
    }

    // Principal arguments of 1 + factor λ less those of 1 + λ, less what of it a change of the factor from 1 on turns.
    double begun(const LoopSample& sample, Complex factor) const {
        double sum = 0.0;
        for (const Complex& locus : sample.loci.values) {
            const Complex one = 1.0 + locus, other = 1.0 + times(factor, locus);
            sum += std::arg(other) - std::arg(one) - turn_between(one, other);
        }
        return sum;
    }

    // Unstable closed-loop roots, as far as the gains move them.
    int counted() {
        double turned = 0.0, orders = 0.0;
        for (std::size_t k = 0; k + 1 < samples_.size(); k++) turned += samples_[k]->turned;
        const std::vector<double> falling = falls();
        LoopSample &first = *samples_.front(), &top = *samples_.back();
        if (!ok()) return -1;
        for (std::size_t i = 0; i < m_; i++) {  // from ω = 0+ to the first sample: integrators point along their own value there
            const double order = std::max(std::round(falling[i]), 0.0);
            const Complex power = std::polar(1.0, 0.5 * kPi * order), one = 1.0 + first.loci.values[i];
            Complex own = times(first.loci.values[i], power);
            if (std::fabs(own.imag()) < kReal * size_of_any(own)) own = own.real() < 0 ? -1.0 : 1.0;
            turned += std::arg(times(one, order > 0 ? times(std::conj(own), power) : Complex(one.real() < 0 ? -1.0 : 1.0)));
            orders += order;
            if (std::isinf(loop_.last)) turned -= std::arg(1.0 + top.loci.values[i]);  // to infinity, where L is 0
        }
        return static_cast<int>(std::lround(loop_.unstable_poles + 0.5 * orders - turned / kPi));
    }

    DirectedLoop& loop_;
    DirectedGains gains_;
    std::size_t m_;
    double wanted_ = 0.0, near_ = 0.0, highest_ = 0.0, peak_ = 0.0, reach_factor_ = 0.0, reach_phase_ = 0.0;
    double longest_ = 0.0;  // of the delays [s]
    LookState state_ = LookState::lost;
    bool idle_ = false;  // some direction has no gains
    bool bottom_ = false, smooth_ = false;  // round-off hides what is further down; S_ii are followed
    int count_ = -1;
    std::vector<std::unique_ptr<LoopSample>> samples_;
    std::map<std::pair<std::size_t, Gain>, std::pair<std::size_t, std::vector<CurvePlace>>> curves_;  // with how many samples they were made of
    SampleSolver solver_;
};

}  // namespace gainroom
