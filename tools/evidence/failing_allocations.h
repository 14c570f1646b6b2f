/* SPDX-License-Identifier: Apache-2.0 */
/* Allocations of a kernel that fail on demand, and are counted. The compiler includes this first.
 *
 * allocations_fail(n) has the allocation number n from now on fail, once; allocations_left() is
 * negative when that has happened; allocations_held() is how many were not freed since. */
#include <stdlib.h>

static long left = -1, held;

void allocations_fail(long number)
{
    left = number;
    held = 0;
}

long allocations_left(void) { return left; }
long allocations_held(void) { return held; }

static int allocation_fails(void) { return left >= 0 && left-- == 0; }

static void *counted(void *block)
{
    held += block != NULL;
    return block;
}

static void counted_free(void *block)
{
    held -= block != NULL;
    free(block);
}

#define malloc(size) (allocation_fails() ? NULL : counted(malloc(size)))
#define calloc(count, size) (allocation_fails() ? NULL : counted(calloc(count, size)))
#define free(block) counted_free(block)
