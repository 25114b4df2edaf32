// Ticks of the gain tracker from standard input, numbers in hexadecimal; ends with status 3 where a tick takes memory, of the heap or of the tracker's block.
//
// After every tick the next contact state is prepared.
//
// n N rows contacts sample_time m, the joints (n, 10), gains of one task of m directions (2, m), then per tick: contact, held directions c,
// A (N, N), J (c, N), the task's Jacobian (m, N). m = 0: joint space.
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <new>
#include <vector>

#include "gainroom/robot_tracker.hpp"

static bool inside = false;

void* operator new(std::size_t size) {
    if (inside) std::_Exit(3);
    if (void* memory = std::malloc(size)) return memory;
    throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

static bool fill(std::vector<double>& values) {
    for (double& value : values)
        if (std::scanf("%la", &value) != 1) return false;
    return true;
}

int main() {
    unsigned joints = 0, size = 0, rows = 0, contacts = 0, count = 0, directions = 0;
    int contact = 0;
    double sample_time = 0.0;
    if (std::scanf("%u %u %u %u %la %u", &joints, &size, &rows, &contacts, &sample_time, &directions) != 6) return 2;
    std::vector<double> table(10 * joints), gains(2 * directions), mass(size * size), task(directions * size), held;
    held.reserve(rows * size);
    if (!fill(table) || !fill(gains)) return 2;
    std::vector<gainroom::JointData> data(joints);
    for (unsigned i = 0; i < joints; i++) {
        const double* v = &table[10 * i];
        data[i] = {v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9]};
    }
    const gainroom::TaskStack stack{{directions}, {gains.begin(), gains.begin() + directions}, {gains.begin() + directions, gains.end()}, rows % 2 == 0};
    const auto made = directions ? std::make_unique<gainroom::RobotTracker>(data.data(), joints, sample_time, size, rows, contacts, stack)
                                 : std::make_unique<gainroom::RobotTracker>(data.data(), joints, sample_time, size, rows, contacts);
    gainroom::RobotTracker& tracker = *made;
    const std::size_t used = tracker.block().used();
    while (std::scanf("%d %u", &contact, &count) == 2) {
        held.resize(count * size);
        if (!fill(mass) || !fill(held) || !fill(task)) return 2;
        inside = true;
        const gainroom::Limit limit = tracker.update(mass.data(), held.data(), count, std::size_t(contact), task.data());
        tracker.prepare(held.data(), count, std::size_t(contact) + 1);
        inside = false;
        if (tracker.block().used() != used) return 3;
        std::printf("%a %a %d %ld %a %d\n", limit.gain, limit.frequency, int(limit.certified), limit.age, limit.safe_gain, int(limit.flag));
    }
}
