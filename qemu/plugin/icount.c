/* Counts the instructions that chosen functions execute, calls included. A plug-in of QEMU's TCG.
 *
 *   -plugin libicount.so,out=FILE,NAME=ADDRESS,NAME=ADDRESS,...
 *
 * A call of a function begins with the instruction at its ADDRESS (hexadecimal, without the Thumb bit) and ends when the
 * instruction after the calling one is reached. FILE gets a line "NAME COUNT" per call, in the order in which they end,
 * and "end" after the last one; what is counted while FILE has no such line was cut off.
 *
 * The header of QEMU's plug-in interface is not part of Debian's packages, so the few declarations needed stand here.
 * None of them has changed from interface 1 (QEMU 4.2) to 5 (QEMU 10.2), only which numbers QEMU accepts.
 */
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef PLUGIN_INTERFACE
#define PLUGIN_INTERFACE 1 /* QEMU before 9.0; 2 from there on */
#endif

#define EXPORT __attribute__((visibility("default")))

typedef uint64_t plugin_id;
struct qemu_info; /* not looked at */
struct qemu_plugin_tb;
struct qemu_plugin_insn;
enum callback_flags { NO_REGISTERS };

void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id, void (*)(plugin_id, struct qemu_plugin_tb *));
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, void (*)(unsigned, void *), enum callback_flags,
                                            void *);
void qemu_plugin_register_atexit_cb(plugin_id, void (*)(plugin_id, void *), void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);
size_t qemu_plugin_insn_size(const struct qemu_plugin_insn *);

EXPORT int qemu_plugin_version = PLUGIN_INTERFACE;

#define MOST_FUNCTIONS 64
#define MOST_NESTED 16
/* A hundred times what the images need: a program that has lost its way must end as well. */
#define MOST_EXECUTED UINT64_C(5000000000)

static struct {
    const char *name;
    uint32_t entry;
} functions[MOST_FUNCTIONS];
static size_t function_count;

static struct {
    const char *name;
    uint32_t return_to;
    uint64_t began;
} calls[MOST_NESTED];
static size_t call_count;

static uint64_t executed;
/* Where execution goes on after the last instruction if that does not branch: what a call returns to. */
static uint32_t following;
static FILE *out;

static void fail(const char *why) {
    fprintf(stderr, "icount: %s\n", why);
    exit(1);
}

/* Thumb instructions begin at even addresses and are 2 or 4 bytes long: both fit one word. */
static void *pack(uint32_t address, bool is_long) {
    return (void *)(uintptr_t)(address | (uint32_t)is_long);
}

static void on_instruction(unsigned cpu, void *packed) {
    (void)cpu;
    uint32_t address = (uint32_t)(uintptr_t)packed & ~UINT32_C(1);
    while (call_count > 0 && calls[call_count - 1].return_to == address) {
        call_count--;
        fprintf(out, "%s %" PRIu64 "\n", calls[call_count].name, executed - calls[call_count].began);
    }
    for (size_t i = 0; i < function_count; i++) {
        if (functions[i].entry == address) {
            if (call_count == MOST_NESTED)
                fail("calls nest too deeply, or one of them never returned");
            calls[call_count].name = functions[i].name;
            calls[call_count].return_to = following;
            calls[call_count].began = executed;
            call_count++;
        }
    }
    if (++executed == MOST_EXECUTED)
        fail("the program does not end");
    following = address + ((uintptr_t)packed & 1 ? 4 : 2);
}

static void on_translation(plugin_id id, struct qemu_plugin_tb *block) {
    (void)id;
    size_t count = qemu_plugin_tb_n_insns(block);
    for (size_t i = 0; i < count; i++) {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
        void *packed =
            pack((uint32_t)qemu_plugin_insn_vaddr(instruction), qemu_plugin_insn_size(instruction) == 4);
        qemu_plugin_register_vcpu_insn_exec_cb(instruction, on_instruction, NO_REGISTERS, packed);
    }
}

static void on_end(plugin_id id, void *unused) {
    (void)id;
    (void)unused;
    for (size_t i = 0; i < call_count; i++)
        fprintf(out, "open %s\n", calls[i].name);
    fputs("end\n", out);
    fclose(out);
}

EXPORT int qemu_plugin_install(plugin_id id, const struct qemu_info *info, int argc, char **argv) {
    (void)info;
    for (int i = 0; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value == NULL)
            fail("an argument is not NAME=VALUE");
        *value++ = '\0';
        if (strcmp(argv[i], "out") == 0) {
            out = fopen(value, "w");
        } else {
            if (function_count == MOST_FUNCTIONS)
                fail("too many functions");
            functions[function_count].name = argv[i];
            functions[function_count].entry = (uint32_t)strtoul(value, NULL, 16);
            function_count++;
        }
    }
    if (out == NULL)
        fail("no file to write to");
    qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation);
    qemu_plugin_register_atexit_cb(id, on_end, NULL);
    return 0;
}
