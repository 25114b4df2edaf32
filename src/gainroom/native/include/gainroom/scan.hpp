// Every crossing and every peak of a scalar response along the boundary of stability, certified between the points.
//
// An interval is bisected until the bounds of response.hpp decide it: it holds no crossing, or the slope has one sign and it holds at most
// one, which bracketed Newton then polishes; no peak inside can be more than 1 % above the best one found. Nothing is interpolated, and
// nothing between two points can be missed; where rounding or the limit of work stops the bisection, `certified` comes back false.
#pragma once

#include <array>

#include "peaks.hpp"

namespace gainroom {

struct GainCrossing {
    double omega, phase;  // |L| = 1; arg L by continuity from small s > 0
};

struct PhaseCrossing {
    double omega, size, rising;  // arg L = π (mod 2π); |L|; sign of the phase's slope, 0 at an end of the boundary
};

struct Scan {
    std::vector<GainCrossing> gains;
    std::vector<PhaseCrossing> phases;
    std::array<Peak, kKinds> peaks{};
    double half_turns = 0.0;  // change of arg(1+L) along the upper half of the contour, divided by π
    bool certified = true;
};

class Scanner {
   public:
    Scanner(const Response& loop, double floor) : loop_(loop), floor_(floor), work_(loop.roots.size()) {}

    Scan run(bool with_peaks) {
        begin();
        finish();
        loop_.breakpoints(first_, last_, ends_, gaps_);
        double end_jump = 0.0;
        if (!gaps_.empty() && gaps_.back().low < last_ && gaps_.back().high >= last_) {  // half of it lies beyond the Nyquist frequency
            last_ = gaps_.back().low;
            end_jump = gaps_.back().jump / 2;
            ends_.erase(std::remove(ends_.begin(), ends_.end(), last_), ends_.end());
            gaps_.pop_back();
        }
        ends_.insert(ends_.begin(), first_);
        ends_.push_back(last_);
        at_first_ = loop_.at(first_);
        const Complex at_last = loop_.at(last_);
        const double last_phase = walk(false);
        bool outside = integrators_ > 0 || (integrators_ == 0 && size_of_any(at_first_) > 1);
        if (end_jump != 0 && (size_of_any(at_last) > 1) != (end_jump < 0)) scan_.gains.push_back({last_, last_phase});
        const bool ends_on_boundary = loop_.sample_time > 0 || loop_.zeros == loop_.poles;
        scan_.half_turns = half_encirclements(start_phase_, outside, ends_on_boundary, last_phase + end_jump, scan_.gains);
        if (beyond_range_) {
            scan_.half_turns = std::numeric_limits<double>::quiet_NaN();
            scan_.certified = false;
        }
        if (integrators_ == 0 && at_first_.real() < 0) scan_.phases.insert(scan_.phases.begin(), {0.0, size_of_any(at_first_), 0.0});
        if (loop_.sample_time > 0 && end_jump == 0 && at_last.real() < 0) scan_.phases.push_back({last_, size_of_any(at_last), 0.0});
        if (with_peaks && !beyond_range_) find_peaks();
        return std::move(scan_);
    }

    // While |L| > 1, arg(1+L) = arg L + arg(1+1/L); while |L| < 1 it cannot turn around. So the gain crossings alone fix it.
    static double half_encirclements(double start_phase, bool outside, bool ends_on_boundary, double last_phase,
                                     const std::vector<GainCrossing>& gains) {
        double turned = 0.0, mark = outside ? start_phase : 0.0;
        for (const GainCrossing& crossing : gains) {
            const double half = wrapped(crossing.phase) / 2;  // arg(1 + e^{j phase})
            turned += (outside ? crossing.phase - half : half) - mark;
            mark = outside ? half : crossing.phase - half;
            outside = !outside;
        }
        const double end = outside && ends_on_boundary ? kPi * std::floor(last_phase / kPi + 0.5) : 0.0;
        return (turned + end - mark) / kPi;
    }

   private:
    static constexpr std::size_t kMostNodes = 50'000, kLeastNodes = 4000;  // bound memory and time; an ordinary loop needs 50 to 300
    static constexpr std::size_t kMostTerms = 1'000'000;                   // the same, of nodes times roots
    static constexpr int kDepth = 60;                                      // of bisection
    static constexpr double kOff = 1e-4;  // of arg(−L) or log|L| at a crossing; beside a resonance without damping it is 1e-16 times its Q

    const Response& loop_;
    double floor_, first_ = 0.0, last_ = 0.0, phase_ = 0.0, start_phase_ = 0.0, scale_ = kInfinite;
    int integrators_ = 0;
    bool beyond_range_ = false;  // the response overflows somewhere
    Complex at_first_;
    Scan scan_;
    std::vector<Slope> work_;
    std::vector<double> ends_, nodes_;
    std::vector<Gap> gaps_;

    // The walk begins at ω = 0, or low enough for the integrators (or differentiators) to rule.
    void begin() {
        start_phase_ = loop_.gain > 0 ? 0.0 : kPi;
        for (const Root& root : loop_.roots) {
            if (root.place == 0.0) {
                integrators_ -= root.sign;
                continue;
            }
            scale_ = std::min(scale_, size_of_any(root.place));
            if (root.place.imag() == 0 && root.place.real() > 0) start_phase_ = kPi - start_phase_;
        }
        if (loop_.delay > 0) scale_ = std::min(scale_, 1 / loop_.delay);
        if (std::isinf(scale_)) scale_ = loop_.gain != 0 ? std::pow(std::fabs(loop_.gain), 1.0 / std::max(std::abs(integrators_), 1)) : 1.0;
        phase_ = start_phase_;
        if (integrators_ == 0) return;
        first_ = 1e-3 * scale_;
        Complex value;
        for (int round = 0; round < 300; round++) {
            value = loop_.at(first_);
            const double size = size_of_any(value);
            if ((integrators_ > 0 ? size > 10 : size < 0.1) || size == 0) break;
            first_ /= 4;
        }
        const double limit = start_phase_ - integrators_ * kPi / 2;
        phase_ = limit + wrapped(std::arg(value) - limit);
    }

    // It ends at the Nyquist frequency, or where |L| stays below the floor: with as many zeros as poles, where it stays near |gain|.
    void finish() {
        if (loop_.sample_time > 0) {
            last_ = kPi / loop_.sample_time;
            return;
        }
        const double limit = std::fabs(loop_.gain);
        const double floor = loop_.zeros == loop_.poles ? limit + (1 - limit) * std::min(500 * floor_, 0.5) : floor_;
        last_ = scale_;
        for (int doubling = 0; doubling < 120; doubling++) {
            last_ *= 2;
            if (loop_.tail_bound(last_, size_of_any(loop_.at(last_))) < floor) return;
        }
        scan_.certified = loop_.zeros == loop_.poles && loop_.delay == 0;
    }

    const Gap* gap_between(double low, double high) const {
        for (const Gap& gap : gaps_)
            if (gap.low == low && gap.high == high) return &gap;
        return nullptr;
    }

    // Along the boundary through every end, bisecting until each interval is decided. Lists crossings and nodes; or, where it seeks peaks,
    // improves those of the scan, which hold a first guess. Returns arg L at the end.
    double walk(bool seek_peaks) {
        const std::size_t size = loop_.roots.size();
        const std::vector<double> ends = seek_peaks ? nodes_ : ends_;
        struct Point {
            double omega;
            Complex value;
            std::vector<Slope> slopes;
        };
        std::vector<Point> stack(kDepth, Point{0.0, 0.0, std::vector<Slope>(size)});
        Point here{ends[0], 0.0, std::vector<Slope>(size)};
        here.value = loop_.at(here.omega, here.slopes.data());
        double log_here = log_size(here.value), phase = phase_;
        beyond_range_ = !std::isfinite(size_of_any(here.value));
        const std::size_t most = std::min(std::max(kMostTerms / (size + 1), kLeastNodes), kMostNodes);
        std::size_t spent = 0;
        if (!seek_peaks) nodes_.assign(1, here.omega);
        for (std::size_t target = 1; target < ends.size(); target++) {
            int top = 0;
            stack[0].omega = ends[target];
            stack[0].value = loop_.at(ends[target], stack[0].slopes.data());
            const Gap* gap = gap_between(ends[target - 1], ends[target]);
            while (top >= 0) {
                Point& there = stack[top];
                const double width = there.omega - here.omega, log_there = log_size(there.value);
                if (!std::isfinite(size_of_any(there.value))) {
                    beyond_range_ = true;
                    return phase;
                }
                double phase_there = phase + turn_between(here.value, there.value);
                if (gap != nullptr) {
                    phase_there = phase + gap->jump + wrapped(phase_there - phase - gap->jump);
                    if (!seek_peaks && gap->jump != 0) {  // |L| is 0 at a zero and infinite at a pole, however near to 1 just beside it
                        if ((log_here > 0) != (gap->jump < 0)) scan_.gains.push_back({here.omega, phase});
                        if ((log_there > 0) != (gap->jump < 0)) scan_.gains.push_back({there.omega, phase_there});
                    }
                } else if (width > 8 * kTiny * there.omega && undecided(seek_peaks, width, here.slopes.data(), there.slopes.data(), size,
                                                                       log_here, log_there, phase, phase_there)) {
                    spent++;
                    if (top + 1 < kDepth && spent < most) {
                        const double a = here.omega, b = there.omega;
                        Point& middle = stack[++top];
                        middle.omega = a > 0 && 4 * a < b ? std::sqrt(a * b) : 0.5 * (a + b);
                        middle.value = loop_.at(middle.omega, middle.slopes.data());
                        if (seek_peaks) improve(middle.omega, middle.value);
                        continue;
                    }
                    scan_.certified = false;
                }
                if (!seek_peaks && (gap == nullptr || gap->jump == 0)) {
                    if ((log_here > 0) != (log_there > 0)) {
                        const double omega = polished_crossing(false, here.omega, there.omega, log_there > log_here);
                        scan_.gains.push_back({omega, phase + turn_between(here.value, loop_.at(omega))});
                    }
                    // L < 0 at an end of the boundary is itself a crossing
                    const bool at_end = loop_.sample_time > 0 && there.omega == ends.back() && there.value.real() < 0;
                    if (half_turns_below(phase) != half_turns_below(phase_there) && !at_end && (here.omega > 0 || here.value.real() > 0)) {
                        const double omega = polished_crossing(true, here.omega, there.omega, phase_there > phase);
                        scan_.phases.push_back({omega, size_of_any(loop_.at(omega)), phase_there > phase ? 1.0 : -1.0});
                    }
                }
                std::swap(here, there);
                log_here = log_there;
                phase = phase_there;
                top--;
                if (!seek_peaks) nodes_.push_back(here.omega);
            }
        }
        return phase;
    }

    bool undecided(bool seek_peaks, double width, const Slope* at_a, const Slope* at_b, std::size_t size, double log_a, double log_b,
                   double phase_a, double phase_b) const {
        const Range turn = range_between(width, at_a, at_b, size, &Slope::turn, -loop_.delay, phase_a, phase_b);
        if (std::max(-turn.steep_low, turn.steep_high) * width > 2.5) return true;  // arg L might turn by more than is seen
        const Range log = range_between(width, at_a, at_b, size, &Slope::size, 0.0, log_a, log_b);
        if (seek_peaks) {
            for (int kind = 0; kind < kKinds; kind++)
                if (objective_bound(kind, log.low, log.high, turn.low, turn.high) < 0.99 * scan_.peaks[kind].lowest) return true;
            return false;
        }
        return (log.steep_low < 0 && log.steep_high > 0 && log.low <= 0 && log.high >= 0) ||
               (turn.steep_low < 0 && turn.steep_high > 0 && half_turns_below(turn.high) >= std::ceil((turn.low - kPi) / (2 * kPi)));
    }

    // Number of odd multiples of π below `phase`, up to a constant.
    static double half_turns_below(double phase) { return std::floor((phase - kPi) / (2 * kPi)); }

    // Root of arg(−L), or of log|L|, in a bracket, by Newton with bisection as the fallback. Whether it is `rising` there must be told: at a
    // point that is itself the crossing, as round numbers make it, the sign of the value does not.
    double polished_crossing(bool of_phase, double low, double high, bool rising) {
        double omega = 0.5 * (low + high);
        for (int round = 0; round < 80; round++) {
            const Complex value = loop_.at(omega, work_.data());
            const double f = of_phase ? std::arg(-value) : log_size(value);
            double slope = of_phase ? -loop_.delay : 0.0;
            for (const Slope& term : work_) slope += of_phase ? term.turn : term.size;
            ((f <= 0) == rising ? low : high) = omega;
            const double step = slope != 0.0 ? omega - f / slope : low;
            if (f == 0.0 || std::fabs(step - omega) <= 1e-15 * omega) break;
            omega = low < step && step < high ? step : 0.5 * (low + high);
        }
        const Complex value = loop_.at(omega);
        if (!(std::fabs(of_phase ? std::arg(-value) : log_size(value)) < kOff)) scan_.certified = false;
        return omega;
    }

    void improve(double omega, Complex value) {
        for (int kind = 0; kind < kKinds; kind++) {
            const double lower = objective(kind, value);
            if (lower < scan_.peaks[kind].lowest) scan_.peaks[kind] = {omega, lower};
        }
    }

    void find_peaks() {
        scan_.peaks.fill({0.0, kInfinite});
        for (const double omega : nodes_) improve(omega, loop_.at(omega));
        walk(true);
        for (int kind = 0; kind < kKinds; kind++) scan_.peaks[kind] = polished(kind, scan_.peaks[kind], loop_, work_);
    }
};

constexpr double kFloor = 1e-3;        // in continuous time the walk ends where |L| stays below
constexpr double kLowestFloor = 1e-9;  // crossings below are left out: which of them comes first is not known

// The scan, as far down as no L < 0 can come nearer to −1 from above than those found; and, with as many zeros as poles, the end at ω = ∞.
inline Scan scan(const Response& loop, bool with_peaks) {
    const bool neutral = loop.zeros == loop.poles;
    double floor = kFloor;
    Scan found;
    for (;;) {
        found = Scanner(loop, floor).run(with_peaks);
        if (loop.sample_time > 0) return found;
        double nearest = 0.0;
        for (const PhaseCrossing& crossing : found.phases)
            if (crossing.size < 1) nearest = std::max(nearest, crossing.size);
        const double limit = std::fabs(loop.gain), reached = neutral ? limit + (1 - limit) * std::min(500 * floor, 0.5) : floor;
        if (!found.certified || nearest >= reached || floor <= kLowestFloor) break;
        floor = std::max({neutral ? 0.0 : nearest, 1e-3 * floor, kLowestFloor});
    }
    auto& phases = found.phases;
    phases.erase(std::remove_if(phases.begin(), phases.end(), [](const PhaseCrossing& c) { return c.size < kLowestFloor; }), phases.end());
    if (neutral && (loop.delay > 0 || loop.gain < 0)) {
        // L tends to its gain, or with a delay to a circle: as near to −|gain| as one likes, at frequencies as high as one likes
        const double limit = std::fabs(loop.gain);
        phases.push_back({kInfinite, limit, 0.0});
        for (int kind = 0; with_peaks && kind < kKinds; kind++) {
            const double lowest = objective(kind, -limit);
            if (lowest < found.peaks[kind].lowest) found.peaks[kind] = {kInfinite, lowest};
        }
    }
    return found;
}

constexpr double kMarginal = 1e-12;  // a crossing with | |L| − 1 | below this puts a root on the boundary: not called stable

// Closed-loop roots right of the imaginary axis (outside the unit circle), and those on it, of a finished scan.
inline double unstable_roots(const Scan& scan, int unstable_poles) {
    int on_boundary = 0;
    for (const PhaseCrossing& crossing : scan.phases) on_boundary += std::fabs(crossing.size - 1) < kMarginal;
    if (on_boundary == 0)  // L may also lie along the real axis, as 1/s² does, and meet −1 without crossing it
        for (const GainCrossing& crossing : scan.gains)
            on_boundary += std::fabs(std::remainder(crossing.phase, 2 * kPi)) > kPi - kMarginal;
    return std::nearbyint(unstable_poles - scan.half_turns) + on_boundary;
}

}  // namespace gainroom
