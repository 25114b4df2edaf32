// The highest σ_max(D (S − T) D⁻¹) over frequency, each with its best D: found by sampling and polishing, and bounded between the samples.
//
// Intervals of ω are divided until on each of them, for some D, σ_max provably stays within kTolerance of the peak (disk_modes.hpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "disk_modes.hpp"

namespace gainroom {

constexpr double kDiskTolerance = 1e-3;  // a peak between the sampled frequencies may be higher than the one found by this share of it
constexpr double kDiskAgreement = 1e-6;  // how far a peak is polished, relative

struct DiskPeak {
    double height = 0.0, omega = 0.0;  // the least σ_max(D (S − T) D⁻¹) over D = e^x at ω [rad/s]
    std::vector<double> x;             // (n)
};

// Peak of any response: `at(omega, matrix)` gives S − T.
template <typename Response>
class PeakSearch {
public:
    PeakSearch(std::size_t n, Response at, double lowest, double highest)
        : n_(n), at_(at), lowest_(lowest), highest_(highest), value_(n), x_(3 * n) {
        matrix_.resize(n, n);
    }

    // The highest peak that samples at `omega` (k), rising, lead to.
    DiskPeak from_samples(const double* omega, std::size_t count) {
        std::vector<double> heights(count), x(count * n_, 0.0), around(count + 2, 0.0);
        std::vector<std::size_t> order(count);
        std::vector<Dense> samples(count);
        for (std::size_t k = 0; k < count; k++) {
            at_(omega[k], samples[k]);
            if (k > 0) std::copy_n(&x[(k - 1) * n_], n_, &x[k * n_]);
            value_.balance(samples[k], &x[k * n_]);
            heights[k] = value_.largest(samples[k], &x[k * n_]);
            order[k] = k;
        }
        std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return heights[a] > heights[b]; });
        double best = 0.0;
        for (std::size_t tried = 0; tried < std::min(count, kMostTried) && heights[order[tried]] > kNear * best; tried++) {
            const std::size_t k = order[tried];
            heights[k] = value_.improve(samples[k], &x[k * n_], kDiskTolerance);
            best = std::max(best, heights[k]);
        }
        std::copy(heights.begin(), heights.end(), around.begin() + 1);
        std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return heights[a] > heights[b]; });
        DiskPeak found;
        std::size_t polishings = 0;
        for (const std::size_t k : order) {
            if (polishings == kMostPolished || !(heights[k] > kNear * best)) break;
            if (heights[k] < around[k] || heights[k] < around[k + 2]) continue;
            const double step = 0.25 * (omega[std::min(k + 1, count - 1)] - omega[k > 0 ? k - 1 : 0]);
            DiskPeak one = polished({heights[k], omega[k], {&x[k * n_], &x[k * n_] + n_}}, step);
            if (one.height > found.height) found = std::move(one);
            polishings++;
        }
        return found;
    }

    // The local peak next to `start`, by parabolas through three points that draw together.
    DiskPeak polished(const DiskPeak& start, double step) {
        DiskPeak best = start;
        best.height = 0.0;
        double omega = start.omega;
        for (int round = 0; round < kRounds; round++) {
            double points[3], heights[3];
            std::size_t highest = 0;
            const std::vector<double> from = best.x;
            for (std::size_t k = 0; k < 3; k++) {
                points[k] = std::clamp(omega + (double(k) - 1) * step, lowest_, highest_);
                at_(points[k], matrix_);
                std::copy_n(from.begin(), n_, &x_[k * n_]);
                heights[k] = value_.improve(matrix_, &x_[k * n_], 0.1 * kDiskAgreement);
                if (heights[k] > heights[highest]) highest = k;
            }
            if (heights[highest] > best.height && std::isfinite(heights[highest]))
                best = {heights[highest], points[highest], {&x_[highest * n_], &x_[highest * n_] + n_}};
            if (!(best.height - std::min({heights[0], heights[1], heights[2]}) > kDiskAgreement * best.height)) break;
            if (highest != 1 && points[highest] > lowest_ && points[highest] < highest_) {
                omega = points[highest];
                step *= 1.5;
                continue;
            }
            const double fall = heights[0] - heights[2], bend = heights[0] - 2 * heights[1] + heights[2];
            omega = best.omega + (highest == 1 && bend < 0 ? 0.5 * step * fall / bend : 0.0);
            step /= 8;
        }
        return best;
    }

private:
    static constexpr std::size_t kMostTried = 48, kMostPolished = 4;  // samples whose D is improved, local peaks that are climbed
    static constexpr double kNear = 0.97;  // of the highest: lower ones are left
    static constexpr int kRounds = 25;

    std::size_t n_;
    Response at_;
    double lowest_, highest_;
    StructuredValue value_;
    std::vector<double> x_;
    Dense matrix_;
};

// Peak of S − T from the modes of a loop, proved between frequencies.
class DiskBound {
public:
    explicit DiskBound(const DiskModes& modes) : modes_(modes), n_(modes.size), expansion_(modes), value_(n_) {}

    DiskPeak peak;
    double bound = std::numeric_limits<double>::infinity();  // of σ_max, each time with some D, over all frequencies; infinite: not proved

    // From samples at `omega` (k), rising from 0.
    void search(const double* omega, std::size_t count, std::size_t most) {
        const auto at = [this](double place, Dense& matrix) { expansion_.at(place, matrix); };
        PeakSearch<decltype(at)> climb(n_, at, 0.0, modes_.last());
        peak = climb.from_samples(omega, count);
        if (peak.x.empty()) return;
        if (modes_.step == 0 && peak.height < 1)  // L → 0: S − T → I
            peak = {1.0, std::numeric_limits<double>::infinity(), std::vector<double>(n_, 0.0)};
        const double least = modes_.step == 0 ? std::max(peak.height, 1 + kDiskTolerance) : peak.height;
        const double end = modes_.step == 0 ? expansion_.end(least) : modes_.last();
        if (std::isfinite(end) && count > 1) certify(climb, least, std::min(omega[1], 0.5 * end), end, most);
    }

private:
    static constexpr std::size_t kRungs = 24;  // intervals that the certificate starts from

    struct Piece {
        double low, high;
    };

    const DiskModes& modes_;
    std::size_t n_;
    DiskExpansion expansion_;
    StructuredValue value_;
    std::vector<Piece> open_;

    // Intervals from 0 to `end`, the first of them up to `first`, are divided until all are bounded, or `most` have been looked at.
    template <typename Climb>
    void certify(Climb& climb, double least, double first, double end, std::size_t most) {
        std::vector<double> x(n_, 0.0);
        open_.clear();
        const double ratio = std::pow(end / first, 1.0 / (kRungs - 1));
        double upper = end;
        for (std::size_t k = 1; k < kRungs; k++) {  // the lowest comes last, and is taken first
            const double low = k + 1 == kRungs ? first : upper / ratio;
            open_.push_back({low, upper});
            upper = low;
        }
        open_.push_back({0.0, upper});
        double reached = least;
        for (std::size_t count = 0; !open_.empty(); count++) {
            if (count >= most) return;
            const Piece now = open_.back();
            open_.pop_back();
            double rest = std::numeric_limits<double>::infinity();
            const double height = judged(climb, now, x, rest), allowed = peak.height * (1 + kDiskTolerance);
            if (height <= allowed) {
                reached = std::max(reached, height);
                continue;
            }
            const std::size_t parts = pieces(height, rest, allowed);
            const double width = (now.high - now.low) / double(parts);
            double high = now.high;
            for (std::size_t k = parts; k-- > 0;) {
                open_.push_back({now.low + double(k) * width, high});
                high = open_.back().low;
            }
        }
        bound = std::max(reached, peak.height);
    }

    // The bound on one interval, from the D of the one before (x); only where that fails for want of a good D is D improved.
    template <typename Climb>
    double judged(Climb& climb, Piece now, std::vector<double>& x, double& rest) {
        const double allowed = peak.height * (1 + kDiskTolerance), failed = std::numeric_limits<double>::infinity();
        if (!expansion_.expand(now.low, now.high)) return failed;
        double height = expansion_.bound(x.data(), allowed, rest);
        if (height <= allowed) return height;
        value_.balance(expansion_.quadratic[0], x.data());
        height = expansion_.bound(x.data(), allowed, rest);
        if (height <= allowed || !(rest < 0.3 * allowed)) return height;
        const double middle = value_.improve(expansion_.quadratic[0], x.data(), 0.01 * kDiskTolerance);
        if (middle > peak.height * (1 + 0.03 * kDiskTolerance) && std::isfinite(middle)) {
            DiskPeak one = climb.polished({middle, expansion_.middle, x}, expansion_.half);
            if (one.height > peak.height) peak = std::move(one);
        }
        return expansion_.bound(x.data(), 0.0, rest);
    }

    // Into how many an interval is divided: the remainder falls with the cube of the width.
    static std::size_t pieces(double height, double rest, double allowed) {
        if (!std::isfinite(rest) || !std::isfinite(height)) return 4;
        const double slack = std::max(allowed - height + rest, 0.02 * allowed);
        return std::size_t(std::clamp(std::ceil(std::cbrt(2 * rest / slack)), 2.0, 5.0));
    }
};

}  // namespace gainroom
