// A scalar response as a product of roots, at one frequency, and what bounds it between two.
//
//   L(v) = gain Π(v − zeros)/Π(v − poles) e^{−jωT},  v = jω, or v = (e^{jωT_s} − 1)/T_s where the loop is sampled
//
// d log L/dω is a sum of one simple term per root. Between breakpoints (frequencies where some term has an extremum) each term is
// monotone, hence its range on an interval is given by its two ends, and the sum of ranges bounds the slopes of log|L| and arg L.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <vector>

#include "complex.hpp"

namespace gainroom {

constexpr double kTiny = 1e-12;  // relative width at which bisection stops, a few thousand times the rounding of a double
constexpr double kInfinite = std::numeric_limits<double>::infinity();

// One root's terms of d log|L|/dω and of d arg L/dω.
struct Slope {
    double size, turn;
};

struct Root {
    Complex place;
    int sign;         // +1 zero, −1 pole
    bool on_axis;     // on the boundary of stability
    double angle;     // ω of the nearest point of the boundary, in [−π/T_s, π/T_s] or (−∞, ∞)
};

// Where roots on the boundary are passed on their right: no point is taken inside, and arg L changes by `jump`.
struct Gap {
    double low, high, jump;
};

class Response {
   public:
    std::vector<Root> roots;  // zero by pole, so that the product stays within range far beyond all roots; poles by their size
    double gain, delay, sample_time;  // sample_time 0: continuous
    int zeros = 0, poles = 0;

    Response(const Complex* zero, std::size_t zero_count, const Complex* pole, std::size_t pole_count, double gain, double delay,
             double sample_time)
        : gain(gain), delay(delay), sample_time(sample_time), zeros(static_cast<int>(zero_count)), poles(static_cast<int>(pole_count)) {
        std::vector<Complex> sorted(pole, pole + pole_count);
        std::stable_sort(sorted.begin(), sorted.end(), [](Complex a, Complex b) { return size_of_any(a) < size_of_any(b); });
        roots.reserve(zero_count + pole_count);
        for (std::size_t k = 0; k < std::max(zero_count, pole_count); k++) {
            if (k < zero_count) roots.push_back(root(zero[k], 1));
            if (k < pole_count) roots.push_back(root(sorted[k], -1));
        }
    }

    // L(jω); `slopes` receives each root's terms where it is given.
    Complex at(double omega, Slope* slopes = nullptr) const {
        Complex v(0.0, omega), dv(0.0, 1.0);
        if (sample_time > 0) {  // v = e^{jθ/2} 2j sin(θ/2)/T_s, without cancellation
            const double half = omega * sample_time / 2;
            const Complex rotation(std::cos(half), std::sin(half));
            v = times(rotation, {0.0, 2 * std::sin(half) / sample_time});
            dv = times({0.0, 1.0}, times(rotation, rotation));
        }
        Complex value(gain * std::cos(omega * delay), -gain * std::sin(omega * delay));
        for (std::size_t k = 0; k < roots.size(); k++) {
            const Complex distance = v - roots[k].place;
            value = roots[k].sign > 0 ? times(value, distance) : over(value, distance);
            if (slopes != nullptr) {
                const Complex term = over(dv, distance);
                slopes[k] = {roots[k].sign * term.real(), roots[k].sign * term.imag()};
            }
        }
        return value;
    }

    // Points in (low, high) where a slope term may have an extremum, sorted, ends of gaps included; and the gaps, which do not overlap.
    void breakpoints(double low, double high, std::vector<double>& points, std::vector<Gap>& gaps) const {
        const double period = sample_time > 0 ? 2 * kPi / sample_time : 0.0;
        points.clear();
        gaps.clear();
        for (const Root& root : roots)
            if (root.on_axis && root.angle > 0) {
                const double spread = 2 * kTiny * root.angle;
                gaps.push_back({root.angle - spread, root.angle + spread, root.sign * kPi});
            }
        merge(gaps);
        for (const Root& root : roots) {
            if (root.on_axis) continue;
            const double x = root.place.real(), rate = x + std::norm(root.place) * sample_time / 2;
            double spread = std::fabs(x);
            if (sample_time > 0) {
                const double radius = std::sqrt(std::max(1 + 2 * sample_time * rate, 0.0));  // |z|
                spread = 2 * std::atan(2 * sample_time * std::fabs(rate) / ((1 + radius) * (1 + radius))) / sample_time;
            }
            for (int side = -1; side <= 1; side++)
                for (int turn = period > 0 ? -1 : 0; turn <= (period > 0 ? 1 : 0); turn++) {
                    const double point = root.angle + side * spread + turn * period;
                    if (point > low && point < high && !inside(gaps, point)) points.push_back(point);
                }
        }
        for (const Gap& gap : gaps)
            for (const double point : {gap.low, gap.high})
                if (point > low && point < high) points.push_back(point);
        std::sort(points.begin(), points.end());
        points.erase(std::unique(points.begin(), points.end()), points.end());
    }

    // Largest |L(jω')| for any ω' >= omega in continuous time, given |L(jω)| = magnitude.
    // Zeros and as many of the slowest poles are bounded together, as |jω' − root|/ω'; each further pole by its least distance.
    double tail_bound(double omega, double magnitude) const {
        if (zeros > poles) return kInfinite;
        double bound = magnitude;
        int paired = 0;
        for (const Root& root : roots) {
            const double x = root.place.real(), y = root.place.imag(), size2 = x * x + y * y;
            // |jω' − root|²/ω'² is a convex quadratic in 1/ω', equal to 1 at ω' = ∞
            const double here = (x * x + (omega - y) * (omega - y)) / (omega * omega);
            if (root.sign > 0) {
                bound *= std::sqrt(std::max(1.0, here) / here);
                continue;
            }
            double least = y > 0 && omega * y <= size2 ? x * x / size2 : std::min(1.0, here);
            if (paired >= zeros) least = y > omega ? x * x / (omega * omega) : here;
            if (!(least > 0)) return kInfinite;
            bound *= std::sqrt(here / least);
            paired++;
        }
        return bound;
    }

   private:
    Root root(Complex place, int sign) const {
        const double rate = place.real() + std::norm(place) * sample_time / 2;
        const double angle =
            sample_time > 0 ? std::atan2(sample_time * place.imag(), 1 + sample_time * place.real()) / sample_time : place.imag();
        return {place, sign, std::fabs(rate) <= 1e-13 * size_of_any(place), place.imag() == 0 ? std::fabs(angle) : angle};
    }

    static void merge(std::vector<Gap>& gaps) {
        std::sort(gaps.begin(), gaps.end(), [](const Gap& a, const Gap& b) { return a.low < b.low; });
        std::size_t count = 0;
        for (const Gap& gap : gaps)
            if (count > 0 && gap.low <= gaps[count - 1].high) {
                gaps[count - 1].high = std::max(gaps[count - 1].high, gap.high);
                gaps[count - 1].jump += gap.jump;
            } else {
                gaps[count++] = gap;
            }
        gaps.resize(count);
    }

    static bool inside(const std::vector<Gap>& gaps, double point) {
        return std::any_of(gaps.begin(), gaps.end(), [&](const Gap& gap) { return point > gap.low && point < gap.high; });
    }
};

// Ranges on an interval of a quantity's slope and of the quantity itself.
struct Range {
    double steep_low, steep_high, low, high;
};

// From the quantity's values at both ends and the sum of its terms' ranges; Slope::*part says which quantity.
inline Range range_between(double width, const Slope* at_a, const Slope* at_b, std::size_t size, double Slope::*part, double offset,
                           double end_a, double end_b) {
    double low = offset, high = offset;
    for (std::size_t k = 0; k < size; k++) {
        low += std::min(at_a[k].*part, at_b[k].*part);
        high += std::max(at_a[k].*part, at_b[k].*part);
    }
    if (low >= 0) return {low, high, end_a, end_b};
    if (high <= 0) return {low, high, end_b, end_a};
    return {low, high, std::max(end_a + low * width, end_b - high * width), std::min(end_a + high * width, end_b - low * width)};
}

}  // namespace gainroom
