// Memory that spills to disk: loaded before all else (LD_PRELOAD), it gives large blocks of memory
// from one file that is mapped, and gives pages back to the system when the process holds too many.
//
// Nothing that computes knows of it, so results are the same to the bit. Before `spill_begin` and
// for small blocks it is the C library's allocator. The file has no name: it is gone with the process.

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>

#define EXPORTED __attribute__((visibility("default")))

extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
void __libc_free(void*);
}

namespace {

constexpr size_t MIB = size_t(1) << 20;
constexpr size_t SPAN = size_t(1) << 40;
// Freed blocks are given out again with their pages; beyond this much, their room on disk goes back.
constexpr size_t KEPT = 1024 * MIB;
// The keeper looks so often, and keeps a margin to the limit that a busy machine can fill between two
// looks. It gives pages back in pieces: a sixteenth of the file or more, since what of it is not in
// memory costs nearly nothing to pass over.
constexpr long LOOK_NANOSECONDS = 2'000'000;
constexpr size_t MARGIN = 96 * MIB;
constexpr size_t PIECE = 4 * MIB;

struct Extent {
  size_t size;
  bool reserved;  // has room on disk
};

struct Spill {
  std::mutex mutex;
  std::map<size_t, Extent> free;  // by offset; neighbours of one kind are one
  std::map<size_t, size_t> held;
  int file = -1;
  size_t span = 0, page = 0, top = 0, kept = 0;
};

// The one mapping, as `free` looks at it without a lock; never unmapped.
std::atomic<char*> base{nullptr};
std::atomic<size_t> reach{0}, least{SIZE_MAX}, limit{0};
Spill* spill = nullptr;

bool is_ours(const void* block) {
  char* first = base.load(std::memory_order_acquire);
  return first && block >= first && block < first + reach.load(std::memory_order_relaxed);
}

size_t offset_of(const void* block) { return static_cast<const char*>(block) - base.load(); }

void put_free(size_t offset, Extent extent) {
  auto& free = spill->free;
  auto next = free.lower_bound(offset);
  if (next != free.begin()) {
    auto before = std::prev(next);
    if (before->first + before->second.size == offset && before->second.reserved == extent.reserved) {
      offset = before->first;
      extent.size += before->second.size;
      free.erase(before);
    }
  }
  if (next != free.end() && offset + extent.size == next->first &&
      next->second.reserved == extent.reserved) {
    extent.size += next->second.size;
    free.erase(next);
  }
  free[offset] = extent;
}

// The smallest free extent that is large enough, taken out; what it has too much stays.
bool take_free(size_t size, bool reserved, size_t& offset) {
  auto best = spill->free.end();
  for (auto it = spill->free.begin(); it != spill->free.end(); ++it) {
    bool fits = it->second.size >= size && it->second.reserved == reserved;
    if (fits && (best == spill->free.end() || it->second.size < best->second.size)) best = it;
  }
  if (best == spill->free.end()) return false;
  Extent extent = best->second;
  offset = best->first;
  spill->free.erase(best);
  if (extent.size > size) put_free(offset + size, {extent.size - size, reserved});
  return true;
}

// Room on disk now, so that no write to the mapping can fail later; systems without it have to trust.
bool reserve(size_t offset, size_t size) {
  while (fallocate(spill->file, 0, offset, size)) {
    if (errno == EINTR) continue;
    return errno == EOPNOTSUPP || errno == ENOSYS;
  }
  return true;
}

void give_back_room() {
  std::map<size_t, Extent> before;
  before.swap(spill->free);
  for (auto& [offset, extent] : before) {
    int flags = FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE;
    bool gone = !extent.reserved || !fallocate(spill->file, flags, offset, extent.size);
    put_free(offset, {extent.size, !gone});
  }
  spill->kept = 0;
}

// Gives pages back to the system; what leaves stays in the file and, as long as there is room, in the
// system's cache.
class Keeper {
 public:
  // Whether the system tells how much is in memory; nothing can be kept where it does not.
  bool sees() const { return status_ >= 0; }

  // Where less than a margin is left to the limit: until there is an eighth more. False where that
  // gave nothing back.
  bool tend() {
    size_t all = limit.load(), margin = std::max(all / 8, std::min(all / 4, MARGIN));
    return lower((all - margin) / spill->page, (all - margin - all / 8) / spill->page);
  }

  // Who asks for memory does it where the keeper is late, and the process above its limit.
  void wait_for_room() {
    size_t most = limit.load() / spill->page;
    if (resident() > std::max(most, rest_.load() + MARGIN / spill->page)) lower(most, most);
  }

 private:
  // Pages in memory, of all kinds; 0 where the system does not tell.
  size_t resident() const {
    char text[64];
    ssize_t read = pread(status_, text, sizeof text - 1, 0);
    if (read <= 0) return 0;
    text[read] = 0;
    size_t total = 0, held = 0;
    return sscanf(text, "%zu %zu", &total, &held) == 2 ? held : 0;
  }

  bool lower(size_t most, size_t wanted) {
    std::lock_guard<std::mutex> lock(mutex_);
    size_t before = resident(), held = before, round = 0, top;
    if (before <= most) return true;
    wanted = std::min(most, std::max(wanted, rest_.load() + PIECE / spill->page));
    {
      std::lock_guard<std::mutex> lock(spill->mutex);
      top = spill->top;
    }
    size_t piece = std::max(PIECE, top / 16 / spill->page * spill->page);
    while (round < top && (held = resident()) > wanted) {
      if (hand_ >= top) hand_ = 0;
      size_t size = std::min(piece, top - hand_);
      madvise(base.load() + hand_, size, MADV_DONTNEED);
      hand_ += size;
      round += size;
    }
    if (round < top) return true;
    rest_ = held = resident();
    return held <= most || before >= held + PIECE / spill->page;
  }

  std::mutex mutex_;
  size_t hand_ = 0;
  std::atomic<size_t> rest_{0};  // pages that no turn through the file gave back
  int status_ = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
};

Keeper* keeper = nullptr;

void* take(size_t asked) {
  size_t size = (asked + spill->page - 1) / spill->page * spill->page;
  keeper->wait_for_room();
  std::lock_guard<std::mutex> lock(spill->mutex);
  size_t offset = 0;
  if (size < asked) return nullptr;
  if (take_free(size, true, offset)) {
    spill->kept -= std::min(spill->kept, size);
  } else {
    bool again = take_free(size, false, offset);
    if (!again) offset = spill->top;
    if (offset + size > spill->span || !reserve(offset, size)) {
      if (again) put_free(offset, {size, false});
      return nullptr;
    }
    if (!again) spill->top += size;
  }
  spill->held[offset] = size;
  return base.load() + offset;
}

void give(void* block) {
  std::lock_guard<std::mutex> lock(spill->mutex);
  auto found = spill->held.find(offset_of(block));
  if (found == spill->held.end()) abort();  // freed twice, or never given
  put_free(found->first, {found->second, true});
  spill->kept += found->second;
  spill->held.erase(found);
  if (spill->kept > KEPT) give_back_room();
}

size_t size_of(void* block) {
  std::lock_guard<std::mutex> lock(spill->mutex);
  return spill->held.at(offset_of(block));
}

size_t (*usable_libc())(void*) {
  static auto found = reinterpret_cast<size_t (*)(void*)>(dlsym(RTLD_NEXT, "malloc_usable_size"));
  return found;
}

void* with_errno(void* block) {
  if (!block) errno = ENOMEM;
  return block;
}

void* keep(void*) {
  timespec rest{0, LOOK_NANOSECONDS}, pause{0, 25 * LOOK_NANOSECONDS};
  while (keeper->sees()) {
    nanosleep(&rest, nullptr);
    // Nothing left to give back: no use in turning all the time.
    if (!keeper->tend()) nanosleep(&pause, nullptr);
  }
  return nullptr;
}

int open_file(const char* folder) {
  int file = open(folder, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (file >= 0) return file;
  char path[4096];
  if (snprintf(path, sizeof path, "%s/.spill-XXXXXX", folder) >= int(sizeof path)) {
    errno = ENAMETOOLONG;
    return -1;
  }
  file = mkostemp(path, O_CLOEXEC);
  if (file >= 0) unlink(path);
  return file;
}

}  // namespace

extern "C" {

// From now on blocks of at least `smallest` bytes are in a file of this folder, and the process is
// kept below `most` bytes. The number of the system's error, 0 if there was none. Again: a new limit.
EXPORTED int spill_begin(const char* folder, size_t most, size_t smallest) {
  limit = most;
  if (spill) return 0;
  auto* made = new Spill;
  made->page = sysconf(_SC_PAGESIZE);
  made->file = open_file(folder);
  if (made->file < 0) return errno;
  void* mapped = MAP_FAILED;
  // A file system may not know files as large.
  for (made->span = SPAN; mapped == MAP_FAILED; made->span /= 2) {
    if (made->span < MIB) return errno;
    if (ftruncate(made->file, made->span)) continue;
    mapped = mmap(nullptr, made->span, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_NORESERVE,
                  made->file, 0);
    if (mapped != MAP_FAILED) break;
  }
  spill = made;
  keeper = new Keeper;
  reach = made->span;
  base.store(static_cast<char*>(mapped), std::memory_order_release);
  pthread_t thread;
  if (int error = pthread_create(&thread, nullptr, keep, nullptr)) return error;
  pthread_detach(thread);
  least = smallest;
  return 0;
}

// Bytes of blocks in the file now.
EXPORTED size_t spill_held() {
  if (!spill) return 0;
  std::lock_guard<std::mutex> lock(spill->mutex);
  size_t sum = 0;
  for (auto& [offset, size] : spill->held) sum += size;
  return sum;
}

EXPORTED void* malloc(size_t size) {
  return size < least.load(std::memory_order_acquire) ? __libc_malloc(size) : with_errno(take(size));
}

EXPORTED void free(void* block) {
  is_ours(block) ? give(block) : __libc_free(block);
}

EXPORTED void* calloc(size_t count, size_t each) {
  size_t size;
  bool large = !__builtin_mul_overflow(count, each, &size) && size >= least.load();
  if (!large) return __libc_calloc(count, each);
  void* block = with_errno(take(size));
  if (block) memset(block, 0, size);
  return block;
}

EXPORTED void* realloc(void* block, size_t size) {
  bool ours = is_ours(block);
  if (!ours && size < least.load()) return __libc_realloc(block, size);
  if (!block) return malloc(size);
  if (ours && !size) {
    give(block);
    return nullptr;
  }
  size_t before = ours ? size_of(block) : usable_libc()(block);
  if (ours && size <= before && size > before / 2) return block;
  void* made = malloc(size);
  if (!made) return nullptr;
  memcpy(made, block, std::min(before, size));
  free(block);
  return made;
}

EXPORTED void* memalign(size_t alignment, size_t size) {
  bool small = size < least.load() || alignment > spill->page;
  return small ? __libc_memalign(alignment, size) : with_errno(take(size));
}

EXPORTED void* aligned_alloc(size_t alignment, size_t size) {
  return memalign(alignment, size);
}

EXPORTED int posix_memalign(void** block, size_t alignment, size_t size) {
  if (!alignment || alignment % sizeof(void*) || (alignment & (alignment - 1))) return EINVAL;
  int before = errno;
  void* made = memalign(alignment, size);
  errno = before;  // it says what failed by its value alone
  if (!made) return ENOMEM;
  *block = made;
  return 0;
}

EXPORTED void* reallocarray(void* block, size_t count, size_t each) {
  size_t size;
  if (__builtin_mul_overflow(count, each, &size)) return with_errno(nullptr);
  return realloc(block, size);
}

EXPORTED size_t malloc_usable_size(void* block) {
  if (!block) return 0;
  return is_ours(block) ? size_of(block) : usable_libc()(block);
}
}
