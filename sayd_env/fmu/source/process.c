/* A model in Python: a process of its own, with which values are exchanged over a socket.

   Needs POSIX. Asked are 'b' (begin) or 's' (step), h and all values; answered is 0 and all values, or
   another byte and a line of text. */

#include <errno.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

typedef struct {
    pid_t process;
    int socket;
    char text[500];
} Process;

static int send_all(int socket, const void *data, size_t size) {
    for (const char *next = data; size;) {
        ssize_t done = send(socket, next, size, MSG_NOSIGNAL);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) return 0;
        next += done;
        size -= (size_t)done;
    }
    return 1;
}

static int receive_all(int socket, void *data, size_t size) {
    for (char *next = data; size;) {
        ssize_t done = recv(socket, next, size, 0);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) return 0;
        next += done;
        size -= (size_t)done;
    }
    return 1;
}

static const char *lost(Process *own, const char *python) {
    snprintf(own->text, sizeof own->text,
             "the Python process has ended (%s -m sayd_env.fmu.serve); this unit needs Python with sayd-env: "
             "the environment variable SAYD_PYTHON names another interpreter",
             python);
    return own->text;
}

static const char *interpreter(void) {
    const char *named = getenv("SAYD_PYTHON");
    return named && *named ? named : PYTHON;
}

static const char *launch(Instance *instance) {
    Process *own = instance->own = calloc(1, sizeof *own);
    int ends[2];
    if (!own) return "no memory";
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends)) {
        free(own);
        instance->own = NULL;
        return "no socket can be opened";
    }
    char *arguments[] = {(char *)interpreter(), "-m", "sayd_env.fmu.serve", instance->resources, NULL};
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 0);
    posix_spawn_file_actions_adddup2(&actions, 2, 1);
    int error = posix_spawn(&own->process, arguments[0], &actions, NULL, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    own->socket = ends[0];
    if (!error) return NULL;
    own->process = 0;
    return lost(own, arguments[0]);
}

static const char *ask(Instance *instance, char what, double h) {
    Process *own = instance->own;
    double *value = instance->state.value;
    char status = 0;
    if (!own || !own->process) return "the Python process does not run";
    if (!send_all(own->socket, &what, 1) || !send_all(own->socket, &h, sizeof h) ||
        !send_all(own->socket, value, VARIABLES * sizeof *value) || !receive_all(own->socket, &status, 1))
        return lost(own, interpreter());
    if (!status)
        return receive_all(own->socket, value, VARIABLES * sizeof *value) ? NULL : lost(own, interpreter());
    size_t n = 0;
    for (char sign; n + 1 < sizeof own->text && receive_all(own->socket, &sign, 1) && sign != '\n';)
        own->text[n++] = sign;
    own->text[n] = 0;
    return own->text;
}

static const char *model_start(Instance *instance) {
    model_stop(instance);
    const char *trouble = launch(instance);
    return trouble ? trouble : ask(instance, 'b', 0.0);
}

static const char *model_step(Instance *instance, double h) { return ask(instance, 's', h); }

static void model_stop(Instance *instance) {
    Process *own = instance->own;
    if (!own) return;
    close(own->socket);
    if (own->process) {
        kill(own->process, SIGTERM);
        while (waitpid(own->process, NULL, 0) < 0 && errno == EINTR) continue;
    }
    free(own);
    instance->own = NULL;
}

static void model_rest(State *state) { (void)state; }
