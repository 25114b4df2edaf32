// Memory of a tracker in one piece: a processor that comes back from other work has to find every page that a tick reads anew.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

#if defined(__GNUC__)
#define GAINROOM_HIDDEN __attribute__((visibility("hidden")))
#else
#define GAINROOM_HIDDEN
#endif

namespace gainroom {

constexpr std::size_t kLine = 64;  // bytes of a line of the cache

// Whether an address sanitizer looks on: it sees where an array ends on the heap alone, so that Vectors lie there then.
#if defined(__SANITIZE_ADDRESS__)
constexpr bool kWatched = true;
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
constexpr bool kWatched = true;
#else
constexpr bool kWatched = false;
#endif
#else
constexpr bool kWatched = false;
#endif

// What is taken from it is given back with it, all at once. While a Filling of it lives, the Vectors that its thread makes lie in it, and what
// in_block makes.
class Block {
public:
    Block() = default;
    Block(const Block&) = delete;
    Block& operator=(const Block&) = delete;
    ~Block() {
        for (const Piece& piece : pieces_) ::operator delete(piece.begin, std::align_val_t(kPiece));
    }

    void* take(std::size_t bytes) {
        const std::size_t whole = (bytes + kLine - 1) / kLine * kLine;
        if (pieces_.empty() || whole > pieces_.back().left) add(std::max(whole, kPiece));
        Piece& piece = pieces_.back();
        void* found = piece.next;
        piece.next += whole;
        piece.left -= whole;
        return found;
    }

    // Bytes that were taken.
    std::size_t used() const {
        std::size_t sum = 0;
        for (const Piece& piece : pieces_) sum += std::size_t(piece.next - static_cast<char*>(piece.begin));
        return sum;
    }

    // Hidden: each library has its own, and can be unloaded.
    GAINROOM_HIDDEN static Block*& filled() {
        thread_local Block* block = nullptr;
        return block;
    }
    class Filling {
    public:
        explicit Filling(Block& block) : before_(filled()) { filled() = kWatched ? nullptr : &block; }
        Filling(const Filling&) = delete;
        Filling& operator=(const Filling&) = delete;
        ~Filling() { filled() = before_; }

    private:
        Block* before_;
    };

private:
    static constexpr std::size_t kPiece = std::size_t(2) << 20;  // bytes: a large page, where the system has them

    struct Piece {
        void* begin;
        char* next;
        std::size_t left;
    };

    void add(std::size_t bytes) {
        pieces_.reserve(pieces_.size() + 1);
        void* begin = ::operator new(bytes, std::align_val_t(kPiece));
#if defined(__linux__)
        madvise(begin, bytes, MADV_HUGEPAGE);  // where that is refused, small ones do
#endif
        pieces_.push_back({begin, static_cast<char*>(begin), bytes});
    }

    std::vector<Piece> pieces_;
};

// Space in the block that is being filled as the allocator is made, or the heap's where none is.
template <class T>
class InBlock {
public:
    using value_type = T;
    using propagate_on_container_move_assignment = std::true_type;
    using propagate_on_container_swap = std::true_type;

    InBlock() : block(Block::filled()) {}
    template <class Other>
    InBlock(const InBlock<Other>& other) : block(other.block) {}
    InBlock select_on_container_copy_construction() const { return {}; }

    T* allocate(std::size_t count) { return block ? static_cast<T*>(block->take(count * sizeof(T))) : std::allocator<T>().allocate(count); }
    void deallocate(T* from, std::size_t count) {
        if (!block) std::allocator<T>().deallocate(from, count);
    }

    Block* block;
};
template <class T, class Other>
bool operator==(const InBlock<T>& a, const InBlock<Other>& b) {
    return a.block == b.block;
}
template <class T, class Other>
bool operator!=(const InBlock<T>& a, const InBlock<Other>& b) {
    return a.block != b.block;
}

template <class T>
using Vector = std::vector<T, InBlock<T>>;

// An object that lies in a block, which has to outlive it.
struct Destroyed {
    template <class T>
    void operator()(T* object) const {
        object->~T();
    }
};
template <class T>
using Owned = std::unique_ptr<T, Destroyed>;

template <class T, class... Arguments>
Owned<T> in_block(Block& block, Arguments&&... arguments) {
    static_assert(alignof(T) <= kLine);
    return Owned<T>(new (block.take(sizeof(T))) T(std::forward<Arguments>(arguments)...));
}

}  // namespace gainroom
