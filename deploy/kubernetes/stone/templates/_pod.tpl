{{/* Pod Security "restricted": no root, no privilege escalation. */}}
{{- define "stone.unprivileged" -}}
runAsNonRoot: true
runAsUser: {{ .uid }}
runAsGroup: {{ .uid }}
fsGroup: {{ .uid }}
fsGroupChangePolicy: OnRootMismatch
seccompProfile: { type: RuntimeDefault }
{{- end }}

{{- define "stone.hardened" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: { drop: [ALL] }
{{- end }}

{{/* The specification of every pod: root, role, settings (of the role), command, grace_s, and optionally processes,
     probes, ports, before_stop_s, backups (a volume source). */}}
{{- define "stone.pod" -}}
automountServiceAccountToken: false
enableServiceLinks: false
terminationGracePeriodSeconds: {{ .grace_s }}
securityContext:
  {{- include "stone.unprivileged" (dict "uid" 10001) | nindent 2 }}
{{- with .root.Values.image.pullSecrets }}
imagePullSecrets:
  {{- range . }}
  - name: {{ . }}
  {{- end }}
{{- end }}
{{- include "stone.place" . }}
containers:
  - name: {{ .role }}
    image: {{ include "stone.image" . }}
    imagePullPolicy: {{ .root.Values.image.pullPolicy }}
    command: {{ toRawJson .command }}
    env:
      {{- include "stone.environment" . | nindent 6 }}
    {{- with .probes }}
    {{- toYaml . | nindent 4 }}
    {{- end }}
    {{- with .ports }}
    ports:
      {{- toYaml . | nindent 6 }}
    {{- end }}
    {{- with .before_stop_s }}
    lifecycle:
      preStop:
        sleep: { seconds: {{ . }} } # whoever still forwards requests here learns of the end first
    {{- end }}
    resources:
      {{- toYaml .settings.resources | nindent 6 }}
    securityContext:
      {{- include "stone.hardened" . | nindent 6 }}
    volumeMounts:
      - { name: scratch, mountPath: /data }
      - { name: temporary, mountPath: /tmp }
      - { name: secrets, mountPath: /run/secrets, readOnly: true }
      {{- if .backups }}
      - { name: backups, mountPath: /backups }
      {{- end }}
volumes:
  - name: scratch
    emptyDir: { sizeLimit: {{ .settings.scratch }} }
  - name: temporary
    emptyDir: { sizeLimit: {{ .settings.temporary }} }
  - name: secrets
    secret:
      {{- include "stone.secrets" . | nindent 6 }}
  {{- with .backups }}
  - name: backups
    {{- toYaml . | nindent 4 }}
  {{- end }}
{{- end }}

{{/* Placement of the pods. */}}
{{- define "stone.place" }}
{{- with .root.Values.nodeSelector }}
nodeSelector:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .root.Values.tolerations }}
tolerations:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .root.Values.spreadOver }}
topologySpreadConstraints:
  {{- range . }}
  - topologyKey: {{ . }}
    maxSkew: 1
    whenUnsatisfiable: ScheduleAnyway
    labelSelector:
      matchLabels:
        {{- include "stone.selector" $ | nindent 8 }}
  {{- end }}
{{- end }}
{{- end }}
