// Where loci and return ratios of coupled loops meet the negative real axis and the unit circle, and how that moves with the gains; the
// least margins of each kind.
//
// At one ω, with V = (I + Q)⁻¹, Q = E P X Δ,
//   dS_ii = −Σ_j (S P X)_ij (E S)_ji dd_j,  S P X = P X (I − Δ V E P X),  E S = V E,      dλ = Σ_j (y E P X)_j x_j dd_j,  y x = 1,
// and with z = ln(−λ) = a + j b, or of ℓ_i = 1/S_ii − 1: on b = 0 a moves by Re z_p − Re z_ω Im z_p/Im z_ω, on a = 0 b by the same of z/j.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "curve_value.hpp"
#include "loop_samples.hpp"
#include "sensitivity_peaks.hpp"

namespace gainroom {

struct CurveStep {
    bool locus;
    std::size_t which;
    double low, high, place;  // ω of the samples before and after, and interpolated
    Complex start, value;  // there
};

struct LeastMargins {
    double factor = std::numeric_limits<double>::infinity(), one_factor = factor;  // |ln g| of all gains, of one loop's
    double phase = factor, one_phase = factor;
    double peak = 0.0, peak_omega = 0.0;
};

// Of one loop, the others closed: |ln g| of its gains up and down, and a phase, at which it is lost.
struct OneLoopMargins {
    double up = std::numeric_limits<double>::infinity(), down = up, phase = up;
};

class LoopCurves {
public:
    explicit LoopCurves(LoopSamples& samples) : samples_(samples), loop_(samples.loop()), n_(loop_.loops()), m_(loop_.directions), at_(loop_) {}

    std::vector<CurveStep> meets(bool locus, bool axis) const {
        std::vector<CurveStep> found;
        if (!samples_.ok()) return found;  // of what is lost the samples are not in order, nor their loci paired
        const auto& all = samples_.samples();
        for (std::size_t k = 0; k + 1 < all.size(); k++) {
            const LoopSample &low = *all[k], &high = *all[k + 1];
            if (locus && !samples_.near(low, high)) continue;
            double noise = 0.0;  // of loci: more directions than motions leave some at 0, where round-off moves them about
            if (locus)
                for (const Complex& value : low.loci.values) noise = std::max(noise, kNoise * kNoise * std::norm(value));
            for (std::size_t i = 0; i < (locus ? m_ : n_); i++) {
                const Complex start = locus ? low.loci.values[i] : low.ratios[i];
                const Complex end = locus ? high.loci.values[low.pairs[i]] : high.ratios[i];
                if (std::norm(start) < noise) continue;
                CurveStep step{locus, i, low.omega(), high.omega(), 0.0, start, 0.0};
                if (axis) {
                    if ((start.imag() > 0) == (end.imag() > 0)) continue;
                    const double share = start.imag() / (start.imag() - end.imag());
                    step.value = (start + share * (end - start)).real();
                    step.place = low.omega() + share * (high.omega() - low.omega());
                    if (!(step.value.real() < 0)) continue;
                } else {
                    if ((std::norm(start) > 1) == (std::norm(end) > 1)) continue;
                    const double first = log_size(start), second = log_size(end);
                    const double share = first / (first - second);
                    step.value = -std::polar(1.0, std::arg(-start) + share * turn_between(start, end));
                    step.place = low.omega() * std::pow(high.omega() / low.omega(), share);
                }
                found.push_back(step);
            }
        }
        return found;
    }

    static double margin_of(Complex value, bool axis) { return axis ? std::log(-value.real()) : std::arg(-value); }

    // The margin at the crossing that is interpolated in `step`, of these gains; `moves` where asked for, by a slope between places that are closer
    // than the samples.
    MovingMargin polished(const CurveStep& step, bool axis, const DirectedGains& gains, double tolerance, int rounds, bool moves) {
        const Complex turn = axis ? Complex(1.0) : Complex(0.0, 1.0);
        double before = step.low, place = step.place;
        Complex back = over(log_of_minus(step.start), turn), here = 0.0, slope = 0.0, guess = step.value;
        MovingMargin result;
        at_.begin(step.locus, step.which);
        for (int round = 0; round < rounds; round++) {
            Complex value;
            if (!at_.evaluate(place, gains, guess, value)) return result;
            result.value = value;
            here = over(log_of_minus(value), turn);
            const double run = place - before;
            if (std::fabs(run) > kSame * place) slope = (here - back) / run;
            const bool there = slope.imag() != 0 && std::fabs(here.imag()) <= tolerance, chord = round == 0 && moves;
            if ((there && !chord) || round + 1 == rounds) break;
            const double away = slope.imag() == 0 || there ? kAside * place : std::clamp(-here.imag() / slope.imag(), -0.1 * place, 0.1 * place);
            before = place;
            back = here;
            place = std::min(place + away, loop_.last);
            if (place == before) break;
            guess = -std::exp((here + slope * (place - before)) * turn);
        }
        const double along = slope.imag() != 0 ? slope.real() / slope.imag() : 0.0;
        result.margin = here.real() - along * here.imag();
        result.omega = place;
        result.found = std::fabs(here.imag()) < kOffCourse;
        if (!moves || !result.found) return result;
        at_.grow();
        result.moves.resize(2 * m_);
        result.shifts.resize(2 * m_);
        for (std::size_t k = 0; k < 2 * m_; k++) {
            const Complex moved = over(at_.growth()[k], turn);
            result.moves[k] = moved.real() - along * moved.imag();
            result.shifts[k] = slope.imag() != 0 ? -moved.imag() / slope.imag() : 0.0;
        }
        return result;
    }

    // Crossings of these gains with an interpolated |margin| below `reach`, each once: those of equal limbs lie so close together that two may be
    // polished to the same. Or the first with a |margin| below `until` alone, as it is.
    std::vector<MovingMargin> crossings(const DirectedGains& gains, bool locus, bool axis, double reach, double until = 0.0) {
        std::vector<MovingMargin> found;
        std::vector<CurveStep> steps = meets(locus, axis);
        const auto size = [axis](const CurveStep& step) { return std::fabs(margin_of(step.value, axis)); };
        if (until > 0) std::stable_sort(steps.begin(), steps.end(), [&](const CurveStep& a, const CurveStep& b) { return size(a) < size(b); });
        for (const CurveStep& step : steps) {
            if (!(size(step) < reach)) continue;
            MovingMargin one = polished(step, axis, gains, kUseful, kFew, !(until > 0));
            if (locus && one.found && among(found, one)) one = other(one, found, axis, gains);
            if (one.found && std::fabs(one.margin) < until) return {one};
            if (one.found) found.push_back(std::move(one));
        }
        return found;
    }

    // Extra delays [s] below `longest` in all loops at which a locus of these gains passes −1, as if an extra delay turned it by ω times
    // itself: exact in continuous time, and of whole ticks.
    std::vector<MovingMargin> delays(const DirectedGains& gains, double longest, bool moves) {
        std::vector<MovingMargin> found;
        for (const CurveStep& step : meets(true, false)) {
            if (!(lag_of(margin_of(step.value, false)) < kEarly * longest * step.place)) continue;
            MovingMargin one = polished(step, false, gains, moves ? kUseful : kExact, moves ? kFew : kRounds, moves);
            const double delay = lag_of(one.margin) / one.omega;
            if (!one.found || !(delay < longest)) continue;
            for (std::size_t k = 0; k < one.moves.size(); k++) one.moves[k] = (one.moves[k] - delay * one.shifts[k]) / one.omega;
            one.margin = delay;
            found.push_back(std::move(one));
        }
        if (moves || found.empty()) return found;
        const auto sooner = [](const MovingMargin& a, const MovingMargin& b) { return a.margin < b.margin; };
        const MovingMargin first = *std::min_element(found.begin(), found.end(), sooner);
        for (const Complex& value : loci_beside(first, gains, kApart)) {  // of equal limbs, of which some may have been polished to the same
            MovingMargin twin = polished(starting(first, value), false, gains, kExact, kRounds, false);
            twin.margin = lag_of(twin.margin) / twin.omega;
            if (twin.found && twin.margin < longest) found.push_back(std::move(twin));
        }
        return found;
    }

    // The crossing of the unit circle by the locus that is nearest to −1 at ω.
    MovingMargin lag_about(double omega) {
        MovingMargin from;
        from.omega = omega;
        from.value = -1.0;
        return polished(starting(from, -1.0), false, samples_.gains(), kExact, kRounds, false);
    }

    // Values that are real and negative where the boundary ends, which a gain moves along the axis, with |ln of them| < `reach`.
    std::vector<MovingMargin> ends(bool locus, const DirectedGains& gains, double reach, bool moves) {
        std::vector<MovingMargin> found;
        if (!samples_.ok()) return found;
        if (std::isfinite(loop_.last)) add_end(*samples_.samples().back(), samples_.samples().back()->loci.values, locus, gains, reach, moves, found);
        // At rest: loci where gravity holds; return ratios also where the other loops leave motions alone that this one's gains hold or topple.
        const double lowest = samples_.samples().front()->omega();
        if (locus && loop_.settles > 0) {
            const auto rest = samples_.sample(loop_.settles * lowest);
            if (rest != nullptr) add_end(*rest, samples_.at_rest(), true, gains, reach, moves, found);
        } else if (!locus) {
            add_settled(lowest, gains, reach, moves, found);
        }
        return found;
    }

    // Of each loop (n): the nearest crossings of its return ratio on either side of −1, where the boundary ends too, and of the unit circle.
    std::vector<OneLoopMargins> one_loop() {
        std::vector<OneLoopMargins> found(n_);
        const std::vector<CurveStep> axis = meets(false, true), circle = meets(false, false);
        for (std::size_t i = 0; i < n_; i++) {
            const auto own = [i](const CurveStep& step) { return step.which == i; };
            const auto larger = [&](const CurveStep& step) { return own(step) && step.value.real() > -1; };
            const auto smaller = [&](const CurveStep& step) { return own(step) && step.value.real() <= -1; };
            found[i].up = std::fabs(first_of(axis, true, larger).margin);
            found[i].down = std::fabs(first_of(axis, true, smaller).margin);
            found[i].phase = std::fabs(first_of(circle, false, own).margin);
        }
        for (const MovingMargin& one : ends(false, samples_.gains(), std::numeric_limits<double>::infinity(), false)) {
            double& least = one.margin < 0 ? found[one.which].up : found[one.which].down;
            least = std::min(least, std::fabs(one.margin));
        }
        return found;
    }

    // Of one loop, every ln g, by size, at which its return ratio is seen to pass −1, where the boundary ends too: more than are roots on the boundary.
    std::vector<double> one_loop_crossings(std::size_t which) {
        std::vector<double> found;
        for (const CurveStep& step : meets(false, true)) {
            if (step.which != which) continue;
            const MovingMargin one = halved(step);
            if (one.found) found.push_back(-one.margin);
        }
        for (const MovingMargin& one : ends(false, samples_.gains(), std::numeric_limits<double>::infinity(), false))
            if (one.which == which) found.push_back(-one.margin);
        std::sort(found.begin(), found.end(), [](double a, double b) { return std::fabs(a) < std::fabs(b); });
        return found;
    }

    // The nearest factors on all gains, above 1 and below it, at which a stable loop is lost: |ln| and ω, 0 at rest; inf where there is none.
    std::pair<MovingMargin, MovingMargin> common_factors() {
        const std::vector<CurveStep> axis = meets(true, true);
        MovingMargin up = first_of(axis, true, [](const CurveStep& step) { return step.value.real() > -1; });
        MovingMargin down = first_of(axis, true, [](const CurveStep& step) { return step.value.real() <= -1; });
        const double lowest = samples_.ok() ? samples_.samples().front()->omega() : 0.0;
        for (const MovingMargin& one : ends(true, samples_.gains(), std::numeric_limits<double>::infinity(), false)) {
            MovingMargin& least = one.margin < 0 ? up : down;
            if (std::fabs(one.margin) < std::fabs(least.margin)) least = one;
            if (least.omega < lowest) least.omega = 0.0;
        }
        for (auto* end : {&up, &down}) {
            end->margin = std::fabs(end->margin);
            const double way = end == &up ? 1.0 : -1.0;
            if (std::isfinite(end->margin)) end->margin = counted(end->margin, [&](double t) { return Complex(std::exp(way * t)); });
        }
        return {up, down};
    }

    // Every crossing of the unit circle, as the phase from −1: by loci, or by each loop's return ratio; as it is interpolated where polishing leaves it.
    std::vector<MovingMargin> phases(bool locus) {
        std::vector<MovingMargin> found;
        for (const CurveStep& step : meets(locus, false)) {
            MovingMargin one = polished(step, false, samples_.gains(), kExact, kRounds, false);
            if (!one.found || one.omega < step.low || one.omega > step.high) {
                one.margin = margin_of(step.value, false);
                one.omega = step.place;
            }
            one.which = step.which;
            found.push_back(std::move(one));
        }
        return found;
    }

    // Of any loop: ln of factors on all gains at which a locus passes −1 within what is followed, and ω.
    std::vector<MovingMargin> passing_factors() {
        std::vector<MovingMargin> found;
        for (const CurveStep& step : meets(true, true)) {
            MovingMargin one = polished(step, true, samples_.gains(), kExact, kRounds, false);
            if (!one.found) continue;
            one.margin = -one.margin;
            found.push_back(std::move(one));
        }
        return found;
    }

    // Of each loop (n) by how much one gain may grow, the others as they are; inf: by any; NaN where its curve is lost.
    std::vector<double> growths(Gain gain) {
        std::vector<double> found(n_, std::numeric_limits<double>::infinity());
        const auto is_negative = [](Complex value) { return value.real() < 0 && std::fabs(value.imag()) < kReal * size_of_any(value); };
        for (std::size_t i = 0; i < n_; i++) {
            std::vector<CurvePlace> curve = samples_.closed_curve(i, gain);
            // A value that is negative at rest puts a single root there; what drifts is more negative the further down.
            const double lowest = curve.empty() ? 0.0 : curve.front().omega;
            while (!curve.empty() && is_negative(curve.front().value) && curve.front().omega > kDeepest * lowest) {
                const auto lower = samples_.inverted(0.25 * curve.front().omega);
                const Complex before = curve.front().value;
                if (lower == nullptr) curve.clear();
                else curve.insert(curve.begin(), {lower->omega(), lower->closed(i, gain)});
                if (!curve.empty() && size_of_any(curve.front().value - before) < kSettled * size_of_any(before)) break;
            }
            if (!curve.empty() && is_negative(curve.front().value)) found[i] = -1 / curve.front().value.real();
            if (curve.empty() || !std::isfinite(curve.front().value.real())) {
                found[i] = std::numeric_limits<double>::quiet_NaN();
                continue;
            }
            for (std::size_t k = 0; k + 1 < curve.size(); k++) {
                const Complex start = curve[k].value, end = curve[k + 1].value;
                if ((start.imag() > 0) != (end.imag() > 0) && (start.real() < 0 || end.real() < 0))
                    found[i] = std::min(found[i], growth_between(i, gain, curve[k], curve[k + 1]));
            }
            if (std::isfinite(loop_.last) && is_negative(curve.back().value)) found[i] = std::min(found[i], -1 / curve.back().value.real());
        }
        return found;
    }

    // The smallest phase [rad] in all loops at which they are lost, > 0 for a lag, and its ω; inf and NaN where there is none.
    MovingMargin common_phase() {
        const std::vector<CurveStep> circle = meets(true, false);
        MovingMargin found = first_of(circle, false, [](const CurveStep&) { return true; });
        for (const double way : {1.0, -1.0}) {
            const double size = std::fabs(found.margin), before = std::isfinite(size) ? counted(size, [&](double t) { return std::polar(1.0, -way * t); }) : size;
            if (before < size) found.margin = way * before;
        }
        return found;
    }

    // NaN where counting roots takes more samples than there may be: then loci are not known between all of them. `apart`: also where loci nearly
    // meet and cross more often than is seen.
    LeastMargins least(bool apart = true) {
        constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
        LeastMargins found = counted_least();
        for (std::size_t before = 0; apart && samples_.ok() && before != samples_.samples().size();) {
            before = samples_.samples().size();
            samples_.tell_apart(found.factor, found.phase);
            if (samples_.ok() && before != samples_.samples().size()) found = counted_least();
        }
        if (!samples_.ok()) found = {unknown, unknown, unknown, unknown, unknown, unknown};
        return found;
    }

private:
    // What is polished: crossings and peaks whose interpolated margins are within kClose of the least, or kSlack [rad, ln].
    static constexpr double kSame = 1e-7, kAside = 1e-5, kOffCourse = 1e-3, kClose = 0.05, kSlack = 0.01, kBefore = 1e-3, kReal = 0.01;
    static constexpr double kExact = 1e-11, kTwins = 0.02, kFar = 1.5, kSettled = 1e-4, kDeepest = 1e-6, kBlur = 1e-6,
                            kNoise = 1e-10;
    static constexpr double kEarly = 1.5;  // of a delay: what is interpolated may be later than what is polished
    // To where crossings are polished that a search follows; what is one of them; so far apart loci of equal limbs are whose gains differ.
    static constexpr double kUseful = 1e-6, kEqual = 1e-5, kApart = 0.3;
    static constexpr int kRounds = 30, kFew = 8, kHalvings = 40;

    LeastMargins counted_least() {
        LeastMargins found;
        found.factor = least_of(true, true);
        for (int way = -1; way <= 1; way += 2)
            if (std::isfinite(found.factor)) found.factor = counted(found.factor, [&](double t) { return Complex(std::exp(way * t)); });
        if (!samples_.ok()) return found;
        found.one_factor = least_of(false, true);
        found.phase = least_of(true, false);
        for (int way = -1; way <= 1; way += 2)
            if (std::isfinite(found.phase)) found.phase = counted(found.phase, [&](double t) { return std::polar(1.0, way * t); });
        if (!samples_.ok()) return found;
        found.one_phase = least_of(false, false);
        for (const bool locus : {true, false})
            for (const MovingMargin& one : ends(locus, samples_.gains(), std::numeric_limits<double>::infinity(), false)) {
                double& least = locus ? found.factor : found.one_factor;
                least = std::min(least, std::fabs(one.margin));
            }
        const MovingMargin top = SensitivityPeaks(samples_).highest(1.0, 0.0);
        found.peak = top.margin;
        found.peak_omega = top.omega;
        return found;
    }

    // In [0, 2π): a lead is as much less than a whole turn of lag.
    static double lag_of(double phase) { return phase < 0 ? phase + 2 * kPi : phase; }

    // The least |margin| among those whose interpolated one may be the least.
    double least_of(bool locus, bool axis) {
        return std::fabs(first_of(meets(locus, axis), axis, [](const CurveStep&) { return true; }).margin);
    }

    // The crossing with the least |margin| of the steps that are `wanted`; of margin inf where there is none.
    template <typename Wanted>
    MovingMargin first_of(std::vector<CurveStep> steps, bool axis, Wanted wanted) {
        steps.erase(std::remove_if(steps.begin(), steps.end(), [&](const CurveStep& step) { return !wanted(step); }), steps.end());
        const auto size = [axis](const CurveStep& step) { return std::fabs(margin_of(step.value, axis)); };
        std::stable_sort(steps.begin(), steps.end(), [&](const CurveStep& a, const CurveStep& b) { return size(a) < size(b); });
        MovingMargin found, first;
        found.margin = std::numeric_limits<double>::infinity();
        found.omega = std::numeric_limits<double>::quiet_NaN();
        const auto nearer = [&found](const MovingMargin& one) { return std::fabs(one.margin) < std::fabs(found.margin); };
        for (const CurveStep& step : steps) {
            const double known = std::fabs(found.margin);
            if (size(step) > known * (1 + (known > 1 ? kFar : kClose)) + kSlack) break;  // what is far is interpolated between fewer samples
            MovingMargin one = polished(step, axis, samples_.gains(), kExact, kRounds, false);
            // One loop's curve was seen on both sides; a locus may have been left for another.
            const bool between = one.omega >= step.low && one.omega <= step.high;
            if (!between && axis && !step.locus) {
                one = halved(step);
                if (!one.found) continue;
            }
            if (one.found && (between || !step.locus || std::fabs(one.margin - margin_of(step.value, axis)) < 0.4)) {
                if (!(std::fabs(one.margin) > known)) first = one;
            } else {
                one.margin = margin_of(step.value, axis);
                one.omega = step.place;
            }
            if (nearer(one)) found = std::move(one);
        }
        if (first.found && steps.front().locus)
            if (MovingMargin twin = beside(first, axis); twin.found && nearer(twin)) found = std::move(twin);
        return found;
    }

    // The crossing with the least |margin| of loci so near to one that crosses that both may have been polished to the same: those of equal limbs.
    MovingMargin beside(const MovingMargin& first, bool axis) {
        MovingMargin found;
        for (const Complex& value : loci_beside(first, samples_.gains(), kTwins)) {
            MovingMargin twin = polished(starting(first, value), axis, samples_.gains(), kExact, kRounds, false);
            if (twin.found && !(found.found && std::fabs(twin.margin) >= std::fabs(found.margin))) found = std::move(twin);
        }
        return found;
    }

    // Where a curve of one loop crosses the real axis between two places with its values there, by halving and chords in turn: `of` is what is read of
    // it once it is evaluated. False where it is lost.
    template <typename Read>
    bool on_axis(std::size_t which, CurvePlace low, CurvePlace high, Read of, CurvePlace& found) {
        at_.begin(false, which);
        for (int round = 0; round < 2 * kHalvings && high.omega - low.omega > 1e-15 * high.omega; round++) {
            const double share = round % 2 == 0 ? low.value.imag() / (low.value.imag() - high.value.imag()) : 0.5;
            found.omega = low.omega + share * (high.omega - low.omega);
            Complex ratio;
            if (!at_.evaluate(found.omega, samples_.gains(), 0.0, ratio)) return false;
            found.value = of(ratio);
            if (std::fabs(found.value.imag()) <= kExact * size_of_any(found.value)) break;
            ((found.value.imag() > 0) == (low.value.imag() > 0) ? low : high) = found;
        }
        return std::fabs(found.value.imag()) < kOffCourse * size_of_any(found.value);
    }

    // The crossing of the negative real axis by one loop's return ratio in `step`; not found where it passes the positive one, or a pole.
    MovingMargin halved(const CurveStep& step) {
        MovingMargin found;
        CurvePlace high{step.high, 0.0}, there{step.low, step.start};
        at_.begin(false, step.which);
        if (!at_.evaluate(step.high, samples_.gains(), 0.0, high.value)) return found;
        found.found = on_axis(step.which, there, high, [](Complex ratio) { return ratio; }, there) && there.value.real() < 0;
        found.value = there.value;
        found.omega = there.omega;
        found.margin = found.found ? std::log(-there.value.real()) : std::numeric_limits<double>::infinity();
        found.which = step.which;
        return found;
    }

    // −1/Re where that curve of a joint crosses the real axis between two places; inf where it is positive there.
    double growth_between(std::size_t joint, Gain gain, const CurvePlace& low, const CurvePlace& high) {
        CurvePlace there = low;
        const bool found = on_axis(joint, low, high, [&](Complex) { return at_.closed(gain); }, there);
        return found && there.value.real() < 0 ? -1 / there.value.real() : std::numeric_limits<double>::infinity();
    }

    // What crosses beside one that others were polished to before, and is not yet among those; not `found` where nothing is.
    MovingMargin other(const MovingMargin& twice, const std::vector<MovingMargin>& before, bool axis, const DirectedGains& gains) {
        for (const Complex& value : loci_beside(twice, gains, kApart)) {
            if (size_of_any(value - twice.value) <= kEqual * size_of_any(value)) continue;
            MovingMargin twin = polished(starting(twice, value), axis, gains, kUseful, kFew, true);
            if (twin.found && !among(before, twin)) return twin;
        }
        return {};
    }

    static bool among(const std::vector<MovingMargin>& all, const MovingMargin& one) {
        return std::any_of(all.begin(), all.end(), [&](const MovingMargin& each) {
            return std::fabs(each.omega - one.omega) <= kEqual * one.omega && size_of_any(each.value - one.value) <= kEqual * size_of_any(one.value);
        });
    }

    static CurveStep starting(const MovingMargin& at, Complex value) { return {true, 0, at.omega, at.omega, at.omega, value, value}; }

    // The loci where one crosses that are `within` a part of it, itself first.
    std::vector<Complex> loci_beside(const MovingMargin& one, const DirectedGains& gains, double within) {
        LoopPoint point;
        if (!loop_.point(one.omega, point)) return {};
        std::vector<Complex> law(m_), values(m_);
        loop_.law(point, gains, law.data());
        if (!samples_.solver().eigenvalues(point, law.data(), values.data())) return {};
        const auto far = [&](Complex value) { return size_of_any(value - one.value) > within * size_of_any(one.value); };
        values.erase(std::remove_if(values.begin(), values.end(), far), values.end());
        const auto nearer = [&](Complex a, Complex b) { return std::norm(a - one.value) < std::norm(b - one.value); };
        std::sort(values.begin(), values.end(), nearer);
        return values;
    }

    // `end`, or where the first root crosses before it: of two crossings close together polishing may find one twice.
    template <typename Factor>
    double counted(double end, Factor factor) {
        double before = (1 - kBefore) * end;
        if (samples_.crossed(factor(before)) == 0 || !samples_.ok()) return end;
        double stable = 0.0;
        for (int round = 0; round < kHalvings && before - stable > 1e-10 * before; round++) {
            const double middle = 0.5 * (stable + before);
            (samples_.crossed(factor(middle)) == 0 ? stable : before) = middle;
        }
        return stable;
    }

    // How far (I + L)⁻¹ may be off by round-off: one motion's share of L drowns beside a much larger one.
    double blurred(const LoopSample& sample) const {
        double loop = 0.0, inverse = 0.0;
        for (std::size_t k = 0; k < m_ * m_; k++) {
            loop = std::max(loop, std::norm(times(sample.point->seen[k], sample.law[k % m_])));
            inverse = std::max(inverse, std::norm(sample.inverse[k]));
        }
        return 2.2e-16 * static_cast<double>(m_) * std::sqrt(loop) * inverse;
    }

    // Return ratios that settle as ω → 0: as far down as they have to be followed, since round-off grows on the way.
    void add_settled(double lowest, const DirectedGains& gains, double reach, bool moves, std::vector<MovingMargin>& found) {
        std::vector<char> told(n_, 0);
        for (double omega = lowest; omega > kDeepest * lowest; omega *= 0.3) {
            const auto rest = samples_.inverted(omega), lower = samples_.inverted(0.5 * omega);
            if (rest == nullptr || lower == nullptr || blurred(*lower) > kBlur) return;
            for (std::size_t i = 0; i < n_; i++) {
                const Complex value = return_ratio(rest->sensitivity[i]), below = return_ratio(lower->sensitivity[i]);
                const bool settled = !told[i] && size_of_any(below - value) < kSettled * size_of_any(value);
                rest->sensitivity[i] = settled ? over(1.0, 1.0 + (4.0 * below - value) / 3.0) : 1.0;  // what is left goes with ω²
                told[i] |= settled;
            }
            add_end(*rest, {}, false, gains, reach, moves, found);
        }
    }

    void add_end(const LoopSample& sample, const std::vector<Complex>& loci, bool locus, const DirectedGains& gains, double reach, bool moves,
                 std::vector<MovingMargin>& found) {
        for (std::size_t i = 0; i < (locus ? loci.size() : n_); i++) {
            const Complex value = locus ? loci[i] : return_ratio(sample.sensitivity[i]);
            if (!(value.real() < 0 && std::fabs(value.imag()) < kReal * size_of_any(value)) || !(std::fabs(log_size(value)) < reach)) continue;
            MovingMargin one;
            one.omega = sample.omega();
            one.which = i;
            one.margin = std::log(-value.real());
            one.found = true;
            if (moves) {
                at_.begin(locus, i);
                Complex there;
                if (!at_.evaluate(one.omega, gains, value, there)) continue;
                one.margin = log_size(there);
                at_.grow();
                one.moves.resize(2 * m_);
                for (std::size_t k = 0; k < 2 * m_; k++) one.moves[k] = at_.growth()[k].real();
            }
            found.push_back(one);
        }
    }

    LoopSamples& samples_;
    DirectedLoop& loop_;
    std::size_t n_, m_;
    CurveValue at_;
};

}  // namespace gainroom
